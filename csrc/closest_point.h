// Closest points on a triangle mesh through a bounding volume hierarchy that is built once and queried many times.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace touchnet {

class TriangleTree {
 public:
  using Point = std::array<double, 3>;

  // vertices (v, 3), faces (f, 3) with f >= 1 and indices in range; both are copied.
  TriangleTree(const double* vertices, const std::int64_t* faces, std::size_t f);

  // points (m, 3), finite -> closest (m, 3), face (m), distance (m). Among equally close triangles the lowest index
  // wins.
  void closest(const double* points, std::size_t m, double* closest, std::int64_t* face, double* distance) const;

 private:
  struct Triangle {
    Point a, b, c;
    std::int64_t face;
  };
  struct Node {
    Point low, high;
    std::uint32_t first;  // leaf: its first triangle; inner: its right child (the left one follows the node)
    std::uint32_t count;  // leaf: how many triangles; inner: 0
  };

  void build(std::vector<std::uint32_t>& order, const std::vector<Triangle>& source, const std::vector<Point>& centres,
             std::size_t begin, std::size_t end);
  static Point closest_on(const Triangle& triangle, const Point& p);
  static double squared_distance(const Node& node, const Point& p);

  std::vector<Triangle> triangles_;
  std::vector<Node> nodes_;
};

}  // namespace touchnet
