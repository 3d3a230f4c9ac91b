// Marching cubes around the surface only: a sparse lattice that grows with the surface, driven by batches of queries.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "cubes.h"

namespace touchnet {

// Use: while (pending()) { write_points / read_values over [0, pending()); advance(); } then count(), emit().
//
// The lattice with the outside layer around the box is cut into blocks of 4x4x4 points, one bit of a 64-bit word each;
// only blocks near the surface exist. A bit of a cell word stands for the cell whose lowest corner is that point.
class OctreeCubes {
 public:
  // Starts from every `stride`-th lattice point on each axis and the last one.
  OctreeCubes(const Lattice& lattice, double level, int64_t stride, int threads);

  // Opens the cells around points (N,3) near the surface, before the first advance(). Points that are not finite are
  // ignored, those outside the box are moved onto it.
  void add_seeds(const double* points, int64_t count);

  int64_t pending() const;
  // Points begin ... begin + count of the pending ones, (count,3).
  template <typename T>
  void write_points(int64_t begin, int64_t count, T* points) const;
  // Their values (count,), finite.
  template <typename T>
  void read_values(int64_t begin, int64_t count, const T* values);
  void advance();

  struct Counts {
    int64_t vertices, faces;
    double minimum, maximum;  // of all values read
  };
  Counts count();
  // vertices (V,3), faces (F,3); where not null: low (V,) is the flat index in the lattice of the lower end of each
  // vertex's edge, or -1 where the edge leaves the box; axis (V,) is the edge's direction.
  void emit(double* vertices, int64_t* faces, int64_t* low, uint8_t* axis) const;

 private:
  struct alignas(64) Block {
    uint64_t inside;   // of the known points; in one cache line with the links, for looking at the neighbours
    uint64_t known;    // points with a value
    int32_t link[11];  // neighbours: 1 ... 7 = (+x, +y, +z) as bits 2, 1, 0; 8, 9, 10 = -x, -y, -z; -1 = not looked up
    uint64_t key;      // position of the block
    uint64_t requested;  // points whose value is pending
    uint64_t wanted;     // cells to visit, or visited
    uint64_t asked;      // of these, those whose corners have been requested
    uint64_t visited;    // of these, those whose neighbours have been wanted
  };
  struct Brick {  // 8x8x8 places for blocks
    uint64_t key;
    std::array<int32_t, 512> block;  // -1 = none
  };
  struct Pending {  // the requested points of a block, and the number of the first among the pending ones
    int32_t block;
    int64_t first;
  };
  struct Segment {  // lattice points start, start + 1, ..., start + length along an axis, counted with the outside
                    // layer
    int64_t start[3];
    int axis;
    int64_t length;
  };
  struct Output {  // of one block
    uint64_t crossed[3];
    uint64_t cells;
    int64_t first_vertex, first_face;
  };

  double& value(int64_t point) { return pages_[point >> kPageBits][point & ((int64_t{1} << kPageBits) - 1)]; }
  double value(int64_t point) const { return pages_[point >> kPageBits][point & ((int64_t{1} << kPageBits) - 1)]; }
  int32_t find_block(int64_t bx, int64_t by, int64_t bz);
  Brick& find_brick(uint64_t key);
  int32_t neighbour(int32_t block, int link);
  int32_t block_of(const int64_t* point) { return find_block(point[0] >> 2, point[1] >> 2, point[2] >> 2); }
  void grow_table();
  void fill_known(Block& block, int32_t index);
  void request(int32_t block, uint64_t points);
  void want(int32_t block, uint64_t cells);
  void add_segment(const int64_t* start, int axis, int64_t length);
  void scan_coarse();
  void open_seeds();
  void want_crossings(const Segment& segment);
  void request_corners(int32_t block);
  void follow(int32_t block);
  void collect_pending();
  template <typename Fn>
  void for_pending(int64_t begin, int64_t end, const Fn& fn) const;
  void corner_signs(const Block& block, uint64_t* signs) const;
  void emit_block(int32_t block, const Output& output, double* vertices, int64_t* faces, int64_t* low,
                  uint8_t* axis) const;

  static constexpr int kPageBits = 16;

  Lattice lattice_;
  double level_;
  int64_t stride_;
  int threads_;

  std::array<std::vector<int64_t>, 3> coarse_;     // lattice indices of the coarse lattice, per axis
  std::array<std::vector<int32_t>, 3> coarse_of_;  // inverse, with the outside layer: -1 = none, -2 = outside the box
  std::vector<double> coarse_values_;
  bool coarse_done_ = false;

  std::vector<Block> blocks_;
  std::vector<std::unique_ptr<double[]>> pages_;
  std::vector<std::unique_ptr<Brick>> bricks_;
  std::vector<int32_t> table_;  // of bricks, open addressing, -1 = free

  std::vector<double> seeds_;
  std::vector<Segment> segments_;
  std::vector<int32_t> front_, next_front_;  // blocks with cells asked and not visited, wanted and not asked
  std::vector<int32_t> requesting_;          // blocks with requested points
  std::vector<Pending> pending_;
  int64_t pending_count_ = 0;
  double minimum_, maximum_;

  std::vector<int32_t> order_;   // blocks by key
  std::vector<Output> outputs_;  // of every block
};

}  // namespace touchnet
