#include "octree.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <numeric>

#include "bits.h"
#include "parallel.h"

namespace touchnet {
namespace {

// Bit 16 x + 4 y + z of a word is point (x, y, z) of its block. Per axis: the distance of neighbours in bits, and the
// points of the first and the last layer.
constexpr int kShift[3] = {16, 4, 1};
constexpr uint64_t kFirst[3] = {0x000000000000FFFF, 0x000F000F000F000F, 0x1111111111111111};
constexpr uint64_t kLast[3] = {0xFFFF000000000000, 0xF000F000F000F000, 0x8888888888888888};
constexpr int kUp[3] = {4, 2, 1};  // links of a block
constexpr int kDown[3] = {8, 9, 10};

constexpr uint64_t block_key(int64_t x, int64_t y, int64_t z) {
  return static_cast<uint64_t>(x) << 42 | static_cast<uint64_t>(y) << 21 | static_cast<uint64_t>(z);
}

constexpr int64_t key_coordinate(uint64_t key, int axis) { return key >> (42 - 21 * axis) & ((1 << 21) - 1); }

inline uint64_t mix(uint64_t key) {
  key *= 0x9E3779B97F4A7C15;
  return key ^ key >> 32;
}

inline int64_t lattice_index(uint64_t key, int bit, int axis) {  // without the outside layer: from -1
  return 4 * key_coordinate(key, axis) + (bit >> (4 - 2 * axis) & 3) - 1;
}

// The word of the points one step further along an axis, given the words of a block and of the next one.
inline uint64_t ahead(uint64_t word, uint64_t next, int axis) {
  return (word & ~kFirst[axis]) >> kShift[axis] | (next & kFirst[axis]) << (3 * kShift[axis]);
}

}  // namespace

OctreeCubes::OctreeCubes(const Lattice& lattice, double level, int64_t stride, int threads)
    : lattice_(lattice),
      level_(level),
      stride_(stride),
      threads_(threads),
      table_(1024, -1),
      minimum_(std::numeric_limits<double>::infinity()),
      maximum_(-std::numeric_limits<double>::infinity()) {
  for (int axis = 0; axis < 3; ++axis) {
    const int64_t points = lattice_.points[axis];
    std::vector<int64_t>& coarse = coarse_[axis];
    for (int64_t i = 0; i < points - 1; i += stride_) coarse.push_back(i);
    coarse.push_back(points - 1);
    coarse_of_[axis].assign((points + 2 + 3) / 4 * 4, -1);
    coarse_of_[axis][0] = -2;
    for (size_t e = points + 1; e < coarse_of_[axis].size(); ++e) coarse_of_[axis][e] = -2;
    for (size_t c = 0; c < coarse.size(); ++c) coarse_of_[axis][coarse[c] + 1] = static_cast<int32_t>(c);
  }
  coarse_values_.resize(coarse_[0].size() * coarse_[1].size() * coarse_[2].size());
}

void OctreeCubes::add_seeds(const double* points, int64_t count) { seeds_.assign(points, points + 3 * count); }

// Sparse storage.

OctreeCubes::Brick& OctreeCubes::find_brick(uint64_t key) {
  const uint64_t mask = table_.size() - 1;
  uint64_t slot = mix(key) & mask;
  for (; table_[slot] >= 0; slot = (slot + 1) & mask) {
    if (bricks_[table_[slot]]->key == key) return *bricks_[table_[slot]];
  }
  table_[slot] = static_cast<int32_t>(bricks_.size());
  bricks_.emplace_back(new Brick{key, {}});
  bricks_.back()->block.fill(-1);
  if (2 * bricks_.size() > table_.size()) grow_table();
  return *bricks_.back();
}

void OctreeCubes::grow_table() {
  table_.assign(2 * table_.size(), -1);
  const uint64_t mask = table_.size() - 1;
  for (size_t b = 0; b < bricks_.size(); ++b) {
    uint64_t slot = mix(bricks_[b]->key) & mask;
    while (table_[slot] >= 0) slot = (slot + 1) & mask;
    table_[slot] = static_cast<int32_t>(b);
  }
}

// The block at a place, made where there is none.
int32_t OctreeCubes::find_block(int64_t bx, int64_t by, int64_t bz) {
  int32_t& block = find_brick(block_key(bx >> 3, by >> 3, bz >> 3)).block[(bx & 7) << 6 | (by & 7) << 3 | (bz & 7)];
  if (block >= 0) return block;
  block = static_cast<int32_t>(blocks_.size());
  blocks_.push_back({0, 0, {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1}, block_key(bx, by, bz), 0, 0, 0, 0});
  if (static_cast<int64_t>(block) * 64 >> kPageBits == static_cast<int64_t>(pages_.size())) {
    pages_.emplace_back(new double[int64_t{1} << kPageBits]);
  }
  fill_known(blocks_.back(), block);
  return block;
}

int32_t OctreeCubes::neighbour(int32_t block, int link) {
  int32_t found = blocks_[block].link[link];
  if (found >= 0) return found;
  const uint64_t key = blocks_[block].key;
  int64_t at[3];
  for (int axis = 0; axis < 3; ++axis) {
    at[axis] = key_coordinate(key, axis) + (link < 8 ? (link & kUp[axis]) != 0 : -(link == kDown[axis]));
  }
  found = find_block(at[0], at[1], at[2]);
  blocks_[block].link[link] = found;
  return found;
}

// A new block knows the coarse values in it, and that everything beyond the box is outside.
void OctreeCubes::fill_known(Block& block, int32_t index) {
  const int32_t* coarse[3];
  for (int axis = 0; axis < 3; ++axis) coarse[axis] = &coarse_of_[axis][4 * key_coordinate(block.key, axis)];
  const int64_t ny = coarse_[1].size(), nz = coarse_[2].size();
  for (int x = 0; x < 4; ++x) {
    if (coarse[0][x] == -2) block.known |= kFirst[0] << (16 * x);
    if (coarse[1][x] == -2) block.known |= kFirst[1] << (4 * x);
    if (coarse[2][x] == -2) block.known |= kFirst[2] << x;
    if (coarse[0][x] < 0) continue;
    for (int y = 0; y < 4; ++y) {
      if (coarse[1][y] < 0) continue;
      for (int z = 0; z < 4; ++z) {
        if (coarse[2][z] < 0) continue;
        const int bit = 16 * x + 4 * y + z;
        const double v = coarse_values_[(coarse[0][x] * ny + coarse[1][y]) * nz + coarse[2][z]];
        value(64 * static_cast<int64_t>(index) + bit) = v;
        block.known |= uint64_t{1} << bit;
        if (v >= level_) block.inside |= uint64_t{1} << bit;
      }
    }
  }
}

void OctreeCubes::request(int32_t block, uint64_t points) {
  Block& b = blocks_[block];
  points &= ~b.known;
  if (!points) return;
  if (!b.requested) requesting_.push_back(block);
  b.requested |= points;
}

void OctreeCubes::want(int32_t block, uint64_t cells) {
  Block& b = blocks_[block];
  cells &= ~b.wanted;
  if (!cells) return;
  if (b.wanted == b.asked) next_front_.push_back(block);
  b.wanted |= cells;
}

// Queries.

int64_t OctreeCubes::pending() const {
  return coarse_done_ ? pending_count_ : static_cast<int64_t>(coarse_values_.size());
}

void OctreeCubes::collect_pending() {
  pending_.clear();
  pending_count_ = 0;
  for (const int32_t block : requesting_) {
    pending_.push_back({block, pending_count_});
    pending_count_ += count_bits(blocks_[block].requested);
  }
}

// Calls fn(block, points of it, number of the first of them) for the pending points begin ... end.
template <typename Fn>
void OctreeCubes::for_pending(int64_t begin, int64_t end, const Fn& fn) const {
  auto at = std::upper_bound(pending_.begin(), pending_.end(), begin,
                             [](int64_t n, const Pending& pending) { return n < pending.first; });
  for (--at; at != pending_.end() && at->first < end; ++at) {
    uint64_t points = blocks_[at->block].requested;
    int64_t first = at->first;
    for (; first < begin; ++first) points &= points - 1;
    if (first + count_bits(points) > end) {
      uint64_t rest = points;
      for (int64_t n = first; n < end; ++n) rest &= rest - 1;
      points &= ~rest;
    }
    if (points) fn(at->block, points, first);
  }
}

template <typename T>
void OctreeCubes::write_points(int64_t begin, int64_t count, T* points) const {
  const int64_t ny = coarse_[1].size(), nz = coarse_[2].size();
  parallel_for(begin, begin + count, worth_threads(0.004 * count, threads_), [&](int64_t first, int64_t last) {
    if (!coarse_done_) {
      for (int64_t n = first; n < last; ++n) {
        const int64_t index[3] = {coarse_[0][n / (ny * nz)], coarse_[1][n / nz % ny], coarse_[2][n % nz]};
        for (int axis = 0; axis < 3; ++axis) {
          points[3 * (n - begin) + axis] = static_cast<T>(vertex_coordinate(lattice_, axis, index[axis], 0));
        }
      }
      return;
    }
    for_pending(first, last, [&](int32_t block, uint64_t wanted, int64_t n) {
      T at[3][4];
      for (int axis = 0; axis < 3; ++axis) {
        const int64_t start = 4 * key_coordinate(blocks_[block].key, axis) - 1;
        for (int k = 0; k < 4; ++k) at[axis][k] = static_cast<T>(vertex_coordinate(lattice_, axis, start + k, 0));
      }
      for (T* point = points + 3 * (n - begin); wanted; wanted &= wanted - 1, point += 3) {
        const int bit = lowest_bit(wanted);
        point[0] = at[0][bit >> 4];
        point[1] = at[1][bit >> 2 & 3];
        point[2] = at[2][bit & 3];
      }
    });
  });
}

template <typename T>
void OctreeCubes::read_values(int64_t begin, int64_t count, const T* values) {
  for (int64_t n = 0; n < count; ++n) {
    minimum_ = std::min(minimum_, static_cast<double>(values[n]));
    maximum_ = std::max(maximum_, static_cast<double>(values[n]));
  }
  if (!coarse_done_) {
    std::copy(values, values + count, coarse_values_.begin() + begin);
    return;
  }
  for_pending(begin, begin + count, [&](int32_t block, uint64_t read, int64_t n) {
    double* const to = &value(64 * static_cast<int64_t>(block));
    uint64_t inside = 0;
    for (const T* from = values + (n - begin); read; read &= read - 1, ++from) {
      const int bit = lowest_bit(read);
      to[bit] = *from;
      inside |= static_cast<uint64_t>(*from >= level_) << bit;
    }
    blocks_[block].inside |= inside;
  });
}

void OctreeCubes::advance() {
  if (!coarse_done_) {
    coarse_done_ = true;
    scan_coarse();
    open_seeds();
  } else {
    for (const int32_t block : requesting_) {
      blocks_[block].known |= blocks_[block].requested;
      blocks_[block].requested = 0;
    }
    requesting_.clear();
    for (const Segment& segment : segments_) want_crossings(segment);
    segments_.clear();
    for (const int32_t block : front_) follow(block);
  }
  for (;;) {
    front_.swap(next_front_);
    next_front_.clear();
    for (const int32_t block : front_) request_corners(block);
    if (!requesting_.empty() || (front_.empty() && segments_.empty())) break;
    for (const Segment& segment : segments_) want_crossings(segment);
    segments_.clear();
    for (const int32_t block : front_) follow(block);
  }
  collect_pending();
}

// Where to start.

void OctreeCubes::add_segment(const int64_t* start, int axis, int64_t length) {
  Segment segment{{start[0], start[1], start[2]}, axis, length};
  int64_t at[3] = {start[0], start[1], start[2]};
  for (int64_t n = 0; n <= length;) {  // block by block
    const int32_t block = block_of(at);
    uint64_t points = 0;
    do {
      points |= uint64_t{1} << ((at[0] & 3) << 4 | (at[1] & 3) << 2 | (at[2] & 3));
      ++n, ++at[axis];
    } while (n <= length && (at[axis] & 3));
    request(block, points);
  }
  segments_.push_back(segment);
}

// Every crossed edge of the coarse lattice is evaluated point by point, so that no surface that crosses it is missed.
// An edge from a border point into the outside layer counts as one, of length 1.
void OctreeCubes::scan_coarse() {
  const int64_t size[3] = {static_cast<int64_t>(coarse_[0].size()), static_cast<int64_t>(coarse_[1].size()),
                           static_cast<int64_t>(coarse_[2].size())};
  const int64_t step[3] = {size[1] * size[2], size[2], 1};
  int64_t flat = 0, c[3];
  for (c[0] = 0; c[0] < size[0]; ++c[0]) {
    for (c[1] = 0; c[1] < size[1]; ++c[1]) {
      for (c[2] = 0; c[2] < size[2]; ++c[2], ++flat) {
        const bool inside = coarse_values_[flat] >= level_;
        for (int axis = 0; axis < 3; ++axis) {
          const bool last = c[axis] + 1 == size[axis];
          int64_t start[3];
          for (int d = 0; d < 3; ++d) start[d] = coarse_[d][c[d]] + 1;
          if (inside && c[axis] == 0) {
            --start[axis];
            add_segment(start, axis, 1);
            ++start[axis];
          }
          const bool next = !last && coarse_values_[flat + step[axis]] >= level_;
          if (inside != next) {
            add_segment(start, axis, last ? 1 : coarse_[axis][c[axis] + 1] - coarse_[axis][c[axis]]);
          }
        }
      }
    }
  }
}

// A seed opens the 27 cells around it, and looks along the three axes as far as one step of the coarse lattice.
void OctreeCubes::open_seeds() {
  const int64_t reach = std::min<int64_t>(stride_, 16);
  for (size_t n = 0; n + 2 < seeds_.size(); n += 3) {
    int64_t cell[3], nearest[3];
    bool finite = true;
    for (int d = 0; d < 3; ++d) {
      const double last = static_cast<double>(lattice_.points[d] - 1);
      const double position = (seeds_[n + d] - lattice_.lower[d]) / lattice_.spacing[d];
      finite = finite && std::isfinite(position);
      const double inside = std::min(std::max(position, 0.0), last);
      cell[d] = finite ? static_cast<int64_t>(std::min(inside, last - 1)) + 1 : 0;
      nearest[d] = finite ? std::llround(inside) + 1 : 0;
    }
    if (!finite) continue;
    for (int m = 0; m < 27; ++m) {
      const int64_t at[3] = {cell[0] + m / 9 - 1, cell[1] + m / 3 % 3 - 1, cell[2] + m % 3 - 1};
      want(block_of(at), uint64_t{1} << ((at[0] & 3) << 4 | (at[1] & 3) << 2 | (at[2] & 3)));
    }
    for (int axis = 0; axis < 3; ++axis) {
      int64_t start[3] = {nearest[0], nearest[1], nearest[2]};
      start[axis] = std::max<int64_t>(nearest[axis] - reach, 0);
      add_segment(start, axis, std::min(nearest[axis] + reach, lattice_.points[axis] + 1) - start[axis]);
    }
  }
  seeds_ = {};
}

void OctreeCubes::want_crossings(const Segment& segment) {
  int64_t at[3] = {segment.start[0], segment.start[1], segment.start[2]};
  const int u = segment.axis == 0 ? 1 : 0, v = segment.axis == 2 ? 1 : 2;
  bool before = false;
  for (int64_t n = 0; n <= segment.length; ++n, ++at[segment.axis]) {
    const int bit = (at[0] & 3) << 4 | (at[1] & 3) << 2 | (at[2] & 3);
    const bool inside = blocks_[block_of(at)].inside >> bit & 1;
    if (n > 0 && inside != before) {
      for (int around = 0; around < 4; ++around) {
        int64_t cell[3] = {at[0], at[1], at[2]};
        --cell[segment.axis];
        cell[u] -= around & 1;
        cell[v] -= around >> 1;
        want(block_of(cell), uint64_t{1} << ((cell[0] & 3) << 4 | (cell[1] & 3) << 2 | (cell[2] & 3)));
      }
    }
    before = inside;
  }
}

// Following the surface, a word of 64 cells at a time.

void OctreeCubes::request_corners(int32_t block) {
  uint64_t need[8] = {blocks_[block].wanted & ~blocks_[block].asked};
  blocks_[block].asked = blocks_[block].wanted;
  for (int axis = 0; axis < 3; ++axis) {  // spread to the points one step up each axis in turn
    for (int link = 0; link < 8; ++link) {
      if (link & kUp[axis] || !need[link]) continue;
      const uint64_t cells = need[link];
      need[link | kUp[axis]] |= (cells & kLast[axis]) >> (3 * kShift[axis]);
      need[link] |= (cells & ~kLast[axis]) << kShift[axis];
    }
  }
  for (int link = 0; link < 8; ++link) {
    if (need[link]) request(link ? neighbour(block, link) : block, need[link]);
  }
}

// Words of the inside bits at the eight corners of the cells of a block.
void OctreeCubes::corner_signs(const Block& block, uint64_t* signs) const {
  for (int link = 0; link < 8; ++link) {
    signs[link] = link == 0 ? block.inside : block.link[link] >= 0 ? blocks_[block.link[link]].inside : 0;
  }
  // signs[link] is that of a whole block; axis by axis it becomes that of the block moved by one point.
  for (int axis = 0; axis < 3; ++axis) {
    for (int link = 0; link < 8; ++link) {
      if (link & kUp[axis]) signs[link] = ahead(signs[link ^ kUp[axis]], signs[link], axis);
    }
  }
}

void OctreeCubes::follow(int32_t block) {
  uint64_t s[8];
  corner_signs(blocks_[block], s);
  const uint64_t fresh = blocks_[block].asked & ~blocks_[block].visited;
  blocks_[block].visited = blocks_[block].asked;
  const auto crossed = [fresh](uint64_t a, uint64_t b, uint64_t c, uint64_t d) {
    return fresh & (a | b | c | d) & ~(a & b & c & d);
  };
  const uint64_t below[3] = {crossed(s[0], s[1], s[2], s[3]), crossed(s[0], s[1], s[4], s[5]),
                             crossed(s[0], s[2], s[4], s[6])};
  const uint64_t above[3] = {crossed(s[4], s[5], s[6], s[7]), crossed(s[2], s[3], s[6], s[7]),
                             crossed(s[1], s[3], s[5], s[7])};
  uint64_t here = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const int shift = kShift[axis];
    here |= (below[axis] & ~kFirst[axis]) >> shift | (above[axis] & ~kLast[axis]) << shift;
    const uint64_t down = (below[axis] & kFirst[axis]) << (3 * shift), up = (above[axis] & kLast[axis]) >> (3 * shift);
    if (down) want(neighbour(block, kDown[axis]), down);
    if (up) want(neighbour(block, kUp[axis]), up);
  }
  want(block, here);
}

// Output.

OctreeCubes::Counts OctreeCubes::count() {
  order_.resize(blocks_.size());
  std::iota(order_.begin(), order_.end(), 0);
  std::sort(order_.begin(), order_.end(), [&](int32_t a, int32_t b) { return blocks_[a].key < blocks_[b].key; });
  outputs_.resize(blocks_.size());
  const int64_t blocks = blocks_.size();
  parallel_for(0, blocks, worth_threads(0.1 * blocks, threads_), [&](int64_t first, int64_t last) {
    for (int64_t b = first; b < last; ++b) {
      uint64_t s[8];
      corner_signs(blocks_[b], s);
      Output& output = outputs_[b];
      const uint64_t visited = blocks_[b].visited;
      // A crossed edge's four cells are all visited or none: the one above its lower end stands for them.
      for (int axis = 0; axis < 3; ++axis) output.crossed[axis] = visited & (s[0] ^ s[kUp[axis]]);
      output.cells = visited & (s[0] | s[1] | s[2] | s[3] | s[4] | s[5] | s[6] | s[7]) &
                     ~(s[0] & s[1] & s[2] & s[3] & s[4] & s[5] & s[6] & s[7]);
      output.first_vertex = output.first_face = 0;
      for (const uint64_t crossed : output.crossed) output.first_vertex += count_bits(crossed);
      for (uint64_t cells = output.cells; cells; cells &= cells - 1) {
        const int bit = lowest_bit(cells);
        int cube = 0;
        for (int corner = 0; corner < 8; ++corner) cube |= (s[corner] >> bit & 1) << corner;
        output.first_face += kCubeTriangles[cube][0];
      }
    }
  });
  Counts counts{0, 0, minimum_, maximum_};
  for (const int32_t b : order_) {
    const int64_t vertices = outputs_[b].first_vertex, faces = outputs_[b].first_face;
    outputs_[b].first_vertex = counts.vertices;
    outputs_[b].first_face = counts.faces;
    counts.vertices += vertices;
    counts.faces += faces;
  }
  return counts;
}

void OctreeCubes::emit_block(int32_t block, const Output& output, double* vertices, int64_t* faces, int64_t* low,
                             uint8_t* axis_of) const {
  const Block& b = blocks_[block];
  // Vertex numbers of the edges of this block's cells, as a lattice of 5x5x5 points per axis.
  int64_t vertex[3][125];
  for (int link = 0; link < 8; ++link) {
    const int32_t at = link == 0 ? block : b.link[link];
    if (at < 0) continue;
    const Output& other = outputs_[at];
    int64_t id = other.first_vertex;
    for (int axis = 0; axis < 3; ++axis) {
      uint64_t layer = ~uint64_t{0};
      for (int d = 0; d < 3; ++d) layer &= link & kUp[d] ? kFirst[d] : ~uint64_t{0};
      if (!(link & kUp[axis])) {
        for (uint64_t crossed = other.crossed[axis] & layer; crossed; crossed &= crossed - 1) {
          const int bit = lowest_bit(crossed);
          const int x = (bit >> 4) + (link & 4), y = (bit >> 2 & 3) + (link & 2) * 2, z = (bit & 3) + (link & 1) * 4;
          vertex[axis][25 * x + 5 * y + z] = id + count_bits(other.crossed[axis] & ((uint64_t{1} << bit) - 1));
        }
      }
      id += count_bits(other.crossed[axis]);
    }
  }

  const int64_t stride[3] = {lattice_.points[1] * lattice_.points[2], lattice_.points[2], 1};
  int64_t id = output.first_vertex;
  for (int axis = 0; axis < 3; ++axis) {
    for (uint64_t crossed = output.crossed[axis]; crossed; crossed &= crossed - 1, ++id) {
      const int bit = lowest_bit(crossed);
      int64_t index[3];
      for (int d = 0; d < 3; ++d) index[d] = lattice_index(b.key, bit, d);
      const bool low_outside = index[axis] < 0, high_outside = index[axis] == lattice_.points[axis] - 1;
      double t;
      if (low_outside || high_outside) {
        t = border_crossing(low_outside);
      } else {
        const bool inner = !(uint64_t{1} << bit & kLast[axis]);
        const int64_t next = inner ? 64 * static_cast<int64_t>(block) + bit + kShift[axis]
                                   : 64 * static_cast<int64_t>(b.link[kUp[axis]]) + bit - 3 * kShift[axis];
        t = crossing(value(64 * static_cast<int64_t>(block) + bit), value(next), level_);
      }
      for (int d = 0; d < 3; ++d) vertices[3 * id + d] = vertex_coordinate(lattice_, d, index[d], d == axis ? t : 0.0);
      if (low) {
        low[id] = low_outside || high_outside ? -1 : index[0] * stride[0] + index[1] * stride[1] + index[2] * stride[2];
        axis_of[id] = static_cast<uint8_t>(axis);
      }
    }
  }

  // Position in `vertex` of a cell's edge, from the position of its lowest corner.
  static constexpr int kEdge[12] = {0, 1, 5, 6, 125, 126, 125 + 25, 125 + 26, 250, 250 + 5, 250 + 25, 250 + 30};
  uint64_t s[8];
  corner_signs(b, s);
  int64_t* out = faces + 3 * output.first_face;
  for (uint64_t cells = output.cells; cells; cells &= cells - 1) {
    const int bit = lowest_bit(cells);
    int cube = 0;
    for (int corner = 0; corner < 8; ++corner) cube |= (s[corner] >> bit & 1) << corner;
    const int64_t* edges = &vertex[0][0] + 25 * (bit >> 4) + 5 * (bit >> 2 & 3) + (bit & 3);
    const int8_t* triangles = kCubeTriangles[cube];
    for (int corner = 0; corner < 3 * triangles[0]; ++corner) *out++ = edges[kEdge[triangles[1 + corner]]];
  }
}

void OctreeCubes::emit(double* vertices, int64_t* faces, int64_t* low, uint8_t* axis) const {
  const int64_t blocks = order_.size(), piece = 256;
  std::atomic<int64_t> next{0};
  parallel_for(0, blocks, worth_threads(0.5 * blocks, threads_), [&](int64_t, int64_t) {
    for (int64_t first; (first = next.fetch_add(piece, std::memory_order_relaxed)) < blocks;) {
      for (int64_t n = first; n < std::min(first + piece, blocks); ++n) {
        emit_block(order_[n], outputs_[order_[n]], vertices, faces, low, axis);
      }
    }
  });
}

template void OctreeCubes::write_points(int64_t, int64_t, float*) const;
template void OctreeCubes::write_points(int64_t, int64_t, double*) const;
template void OctreeCubes::read_values(int64_t, int64_t, const float*);
template void OctreeCubes::read_values(int64_t, int64_t, const double*);

}  // namespace touchnet
