// A long run of the extraction on small random fields, dense and octree, with every mesh checked. From the root:
//   g++ -O2 -std=c++17 -ffp-contract=off -Icsrc tests/cpp/fuzz_extraction.cpp csrc/cpu/marching_cubes.cpp
//       csrc/cpu/octree.cpp -o fuzz -lpthread && ./fuzz 1000000
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "marching_cubes.h"
#include "octree.h"

using namespace touchnet;

struct Random {
  uint64_t state;
  uint64_t bits() {  // splitmix64
    uint64_t z = state += 0x9E3779B97F4A7C15;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9;
    z = (z ^ z >> 27) * 0x94D049BB133111EB;
    return z ^ z >> 31;
  }
  int64_t below(int64_t n) { return static_cast<int64_t>(bits() % static_cast<uint64_t>(n)); }
  double uniform() { return static_cast<double>(bits() >> 11) * 0x1p-53; }
  double noise() { return uniform() + uniform() + uniform() + uniform() - 2; }
};

struct Mesh {
  std::vector<double> vertices;
  std::vector<int64_t> faces;
};

constexpr int kKinds = 12;
const char* const kNames[kKinds] = {"white noise",
                                    "smoothed noise",
                                    "plateau at the level",
                                    "small integers",
                                    "sheet",
                                    "border",
                                    "inside everywhere",
                                    "1e-30",
                                    "subnormal",
                                    "1e30",
                                    "3e38",
                                    "1.7e308"};

// Fills a volume and returns its level.
double make(Random& random, int kind, const Lattice& lattice, std::vector<double>& volume) {
  const double normal[3] = {random.noise(), random.noise(), random.noise()};
  const double length = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]) + 1e-9;
  const bool free[3] = {random.below(2) == 0, random.below(2) == 0, random.below(2) == 0};
  size_t n = 0;
  for (int64_t i = 0; i < lattice.points[0]; ++i) {
    for (int64_t j = 0; j < lattice.points[1]; ++j) {
      for (int64_t k = 0; k < lattice.points[2]; ++k, ++n) {
        double& value = volume[n];
        value = random.noise();
        const double sign = value < 0 ? -1 : 1, integer = static_cast<double>(random.below(5) - 2);
        switch (kind) {
          case 1:
            if (n) value = 0.3 * value + 0.7 * volume[n - 1];
            break;
          case 2:
            value = 0.5 + 0.5 * std::min(std::max(integer, -1.0), 1.0);
            break;
          case 3:
            value = integer;
            break;
          case 4:
            value = 0.4 - std::abs((normal[0] * (i - 1.5) + normal[1] * (j - 1.5) + normal[2] * (k - 1.5)) / length);
            break;
          case 5:
            if ((free[0] || i == 0) && (free[1] || j == 0) && (free[2] || k == 0)) value = 1;
            break;
          case 6:
            value = 1 + std::abs(value);
            break;
          case 7:
            value *= 1e-30;
            break;
          case 8:
            value = integer * 5e-324;
            break;
          case 9:
            value *= 1e30;
            break;
          case 10:
            value = sign * 3e38;
            break;
          case 11:
            value = sign * 1.7e308;
            break;
          default:
            break;
        }
      }
    }
  }
  const double levels[kKinds] = {0.1, 0, 0.5, 0, 0, 0.5, 1, 0, 0, 0.5, 0, -1e300};
  return levels[kind];
}

// What is wrong with a mesh, or null.
const char* fault(const Mesh& mesh) {
  const int64_t sides = static_cast<int64_t>(mesh.faces.size()),
                vertices = static_cast<int64_t>(mesh.vertices.size()) / 3;
  const auto after = [](int64_t s) { return s % 3 == 2 ? s - 2 : s + 1; };
  std::vector<std::pair<int64_t, int64_t>> order(sides);  // directed side, its number
  std::vector<char> used(vertices, 0);
  for (int64_t s = 0; s < sides; ++s) {
    const int64_t a = mesh.faces[s], b = mesh.faces[after(s)];
    if (a < 0 || a >= vertices) return "a face has a vertex that is not there";
    order[s] = {a * vertices + b, s};
    used[a] = 1;
  }
  if (std::count(used.begin(), used.end(), 0)) return "a vertex is in no face";
  std::sort(order.begin(), order.end());
  std::vector<int64_t> turn(sides);  // the next side round the vertex at which a side starts
  for (int64_t n = 0; n < sides; ++n) {
    if (n && order[n].first == order[n - 1].first) return "a side is used twice in one direction";
    const int64_t reverse = order[n].first % vertices * vertices + order[n].first / vertices;
    const auto partner = std::lower_bound(order.begin(), order.end(), std::make_pair(reverse, int64_t{0}));
    if (partner == order.end() || partner->first != reverse) return "a side has no partner";
    turn[order[n].second] = after(partner->second);
  }
  int64_t fans = 0;
  std::vector<char> seen(sides, 0);
  for (int64_t s = 0; s < sides; ++s) {
    fans += !seen[s];
    for (int64_t at = s; !seen[at]; at = turn[at]) seen[at] = 1;
  }
  if (fans != vertices) return "a vertex has more than one fan";
  double volume = 0;
  for (int64_t f = 0; f < sides; f += 3) {
    const double *a = &mesh.vertices[3 * mesh.faces[f]], *b = &mesh.vertices[3 * mesh.faces[f + 1]],
                 *c = &mesh.vertices[3 * mesh.faces[f + 2]];
    const double u[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]}, v[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    const double normal[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    if (!(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2] > 0)) return "a face has no area";
    volume += normal[0] * a[0] + normal[1] * a[1] + normal[2] * a[2];
  }
  return volume > 0 ? nullptr : "the mesh is inside out";
}

template <typename T>
bool dense(const std::vector<double>& volume, const Lattice& lattice, double level, Mesh& mesh) {
  const std::vector<T> values(volume.begin(), volume.end());
  DenseCubes<T> cubes(values.data(), lattice, level, 1);
  const auto counts = cubes.count();
  mesh.vertices.resize(3 * counts.vertices);
  mesh.faces.resize(3 * counts.faces);
  if (counts.vertices) cubes.emit(mesh.vertices.data(), mesh.faces.data(), nullptr, nullptr);
  return counts.vertices > 0;
}

void octree(const std::vector<double>& volume, const Lattice& lattice, double level, Mesh& mesh) {
  OctreeCubes cubes(lattice, level, 1, 1);
  while (const int64_t pending = cubes.pending()) {
    std::vector<double> points(3 * pending), values(pending);
    cubes.write_points(0, pending, points.data());
    for (int64_t n = 0; n < pending; ++n) {
      int64_t index[3];
      for (int d = 0; d < 3; ++d) index[d] = std::llround((points[3 * n + d] - lattice.lower[d]) / lattice.spacing[d]);
      values[n] = volume[(index[0] * lattice.points[1] + index[1]) * lattice.points[2] + index[2]];
    }
    cubes.read_values(0, pending, values.data());
    cubes.advance();
  }
  const auto counts = cubes.count();
  mesh.vertices.resize(3 * counts.vertices);
  mesh.faces.resize(3 * counts.faces);
  cubes.emit(mesh.vertices.data(), mesh.faces.data(), nullptr, nullptr);
}

// The faces as corner coordinates, each turned to start at its least corner, in order.
std::vector<std::array<std::array<double, 3>, 3>> sorted_faces(const Mesh& mesh) {
  std::vector<std::array<std::array<double, 3>, 3>> faces(mesh.faces.size() / 3);
  for (size_t f = 0; f < faces.size(); ++f) {
    for (int corner = 0; corner < 3; ++corner) {
      for (int d = 0; d < 3; ++d) faces[f][corner][d] = mesh.vertices[3 * mesh.faces[3 * f + corner] + d];
    }
    std::rotate(faces[f].begin(), std::min_element(faces[f].begin(), faces[f].end()), faces[f].end());
  }
  std::sort(faces.begin(), faces.end());
  return faces;
}

int main(int argc, char** argv) {
  const int64_t count = argc > 1 ? std::atoll(argv[1]) : 10000;
  Random random{argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 0};
  int64_t faces = 0, compared = 0;
  Mesh mesh, other;
  std::vector<double> volume;
  for (int64_t done = 0; done < count;) {
    const int kind = static_cast<int>(random.below(kKinds));
    Lattice lattice;
    for (int d = 0; d < 3; ++d) {
      lattice.points[d] = 2 + random.below(3);
      lattice.lower[d] = -1;
      lattice.spacing[d] = 2.0 / static_cast<double>(lattice.points[d] - 1);
    }
    volume.resize(lattice.points[0] * lattice.points[1] * lattice.points[2]);
    const double level = make(random, kind, lattice, volume);
    const bool narrow = kind < 8 && kind != 1 && random.below(2);
    if (!(narrow ? dense<float>(volume, lattice, level, mesh) : dense<double>(volume, lattice, level, mesh))) continue;
    ++done;
    faces += static_cast<int64_t>(mesh.faces.size()) / 3;
    if (const char* wrong = fault(mesh)) {
      std::printf("field %lld (%s): %s\n", static_cast<long long>(done), kNames[kind], wrong);
      return 1;
    }
    if (!narrow && done % 4 == 0) {
      ++compared;
      octree(volume, lattice, level, other);
      if (sorted_faces(mesh) != sorted_faces(other)) {
        std::printf("field %lld (%s): the octree's mesh differs\n", static_cast<long long>(done), kNames[kind]);
        return 1;
      }
    }
    if (done % 100000 == 0) {
      std::printf("%lld fields, %lld faces, no fault; %lld equal to the octree's\n", static_cast<long long>(done),
                  static_cast<long long>(faces), static_cast<long long>(compared));
      std::fflush(stdout);
    }
  }
  return 0;
}
