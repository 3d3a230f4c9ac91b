#include "closest_point.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace touchnet {
namespace {

using Point = TriangleTree::Point;

Point minus(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
double dot(const Point& a, const Point& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Point along(const Point& a, double t, const Point& d) { return {a[0] + t * d[0], a[1] + t * d[1], a[2] + t * d[2]}; }

constexpr std::size_t leaf_size = 4;

}  // namespace

// Voronoi regions of the triangle: corners first, then edges, then the face (Ericson, Real-Time Collision Detection
// 5.1.5). A denominator is zero only for a triangle without area, where the region's edge is taken at its start.
TriangleTree::Point TriangleTree::closest_on(const Triangle& t, const Point& p) {
  const Point ab = minus(t.b, t.a), ac = minus(t.c, t.a);
  const Point ap = minus(p, t.a);
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return t.a;
  const Point bp = minus(p, t.b);
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return t.b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return along(t.a, d1 > d3 ? d1 / (d1 - d3) : 0, ab);
  const Point cp = minus(p, t.c);
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return t.c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return along(t.a, d2 > d6 ? d2 / (d2 - d6) : 0, ac);
  const double va = d3 * d6 - d5 * d4, e = d4 - d3, f = d5 - d6;
  if (va <= 0 && e >= 0 && f >= 0) return along(t.b, e + f > 0 ? e / (e + f) : 0, minus(t.c, t.b));
  const double total = va + vb + vc;
  const double v = vb / total, w = vc / total;
  return along(along(t.a, v, ab), w, ac);
}

double TriangleTree::squared_distance(const Node& node, const Point& p) {
  double sum = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double d = std::max({node.low[axis] - p[axis], 0.0, p[axis] - node.high[axis]});
    sum += d * d;
  }
  return sum;
}

void TriangleTree::build(std::vector<std::uint32_t>& order, const std::vector<Triangle>& source,
                         const std::vector<Point>& centres, std::size_t begin, std::size_t end) {
  const std::size_t index = nodes_.size();
  nodes_.push_back({source[order[begin]].a, source[order[begin]].a, 0, 0});
  Point low = nodes_[index].low, high = low, centre_low = centres[order[begin]], centre_high = centre_low;
  for (std::size_t i = begin; i < end; ++i) {
    const Triangle& t = source[order[i]];
    for (int axis = 0; axis < 3; ++axis) {
      low[axis] = std::min({low[axis], t.a[axis], t.b[axis], t.c[axis]});
      high[axis] = std::max({high[axis], t.a[axis], t.b[axis], t.c[axis]});
      centre_low[axis] = std::min(centre_low[axis], centres[order[i]][axis]);
      centre_high[axis] = std::max(centre_high[axis], centres[order[i]][axis]);
    }
  }
  nodes_[index].low = low;
  nodes_[index].high = high;
  if (end - begin <= leaf_size) {
    nodes_[index].first = static_cast<std::uint32_t>(triangles_.size());
    nodes_[index].count = static_cast<std::uint32_t>(end - begin);
    for (std::size_t i = begin; i < end; ++i) triangles_.push_back(source[order[i]]);
    return;
  }
  int axis = 0;
  for (int other = 1; other < 3; ++other)
    if (centre_high[other] - centre_low[other] > centre_high[axis] - centre_low[axis]) axis = other;
  const std::size_t middle = begin + (end - begin) / 2;
  std::nth_element(order.begin() + begin, order.begin() + middle, order.begin() + end,
                   [&](std::uint32_t a, std::uint32_t b) {
                     return centres[a][axis] != centres[b][axis] ? centres[a][axis] < centres[b][axis] : a < b;
                   });
  build(order, source, centres, begin, middle);
  nodes_[index].first = static_cast<std::uint32_t>(nodes_.size());
  build(order, source, centres, middle, end);
}

TriangleTree::TriangleTree(const double* vertices, const std::int64_t* faces, std::size_t f) {
  std::vector<Triangle> source(f);
  std::vector<Point> centres(f);
  std::vector<std::uint32_t> order(f);
  std::iota(order.begin(), order.end(), 0u);
  for (std::size_t i = 0; i < f; ++i) {
    Point corner[3];
    for (int k = 0; k < 3; ++k)
      for (int axis = 0; axis < 3; ++axis) corner[k][axis] = vertices[3 * faces[3 * i + k] + axis];
    source[i] = {corner[0], corner[1], corner[2], static_cast<std::int64_t>(i)};
    for (int axis = 0; axis < 3; ++axis) centres[i][axis] = corner[0][axis] + corner[1][axis] + corner[2][axis];
  }
  triangles_.reserve(f);
  nodes_.reserve(f);
  build(order, source, centres, 0, f);
}

void TriangleTree::closest(const double* points, std::size_t m, double* closest, std::int64_t* face,
                           double* distance) const {
  struct Entry {
    double bound;
    std::uint32_t node;
  };
  for (std::size_t i = 0; i < m; ++i) {
    const Point p = {points[3 * i], points[3 * i + 1], points[3 * i + 2]};
    double best = std::numeric_limits<double>::infinity();
    std::int64_t best_face = -1;
    Point best_point = p;
    Entry stack[64];  // median splits: the depth is at most log2(2^32 / leaf_size)
    int top = 0;
    stack[top++] = {0, 0};
    while (top > 0) {
      const Entry entry = stack[--top];
      if (entry.bound > best) continue;
      const Node& node = nodes_[entry.node];
      if (node.count > 0) {
        for (std::uint32_t k = node.first; k < node.first + node.count; ++k) {
          const Triangle& triangle = triangles_[k];
          const Point q = closest_on(triangle, p);
          const Point d = minus(p, q);
          const double squared = dot(d, d);
          if (squared < best || (squared == best && triangle.face < best_face)) {
            best = squared;
            best_face = triangle.face;
            best_point = q;
          }
        }
        continue;
      }
      Entry near = {0, entry.node + 1}, far = {0, node.first};
      near.bound = squared_distance(nodes_[near.node], p);
      far.bound = squared_distance(nodes_[far.node], p);
      if (far.bound < near.bound) std::swap(near, far);
      if (far.bound <= best) stack[top++] = far;
      if (near.bound <= best) stack[top++] = near;
    }
    for (int axis = 0; axis < 3; ++axis) closest[3 * i + axis] = best_point[axis];
    face[i] = best_face;
    distance[i] = std::sqrt(best);
  }
}

}  // namespace touchnet
