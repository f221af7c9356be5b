// Multi-resolution hash grid with two features per entry (Mueller et al. 2022), eight points at a time.
//
// soar/raster/hashgrid.py states the definition. The table gradient runs one job per level and the point gradient one
// per block of points, so that every sum has one writer and a fixed order.
#include "simd.h"
#include "team.h"

namespace soar {
namespace {

constexpr int kBlock = 512;  // points per job: their codes stay in the first-level cache while levels change

struct Grid {
  const float* planar;  // (3, stride): points, the last one repeated up to a multiple of the lanes
  int64_t stride, count;
  const float* table;  // (levels, entries, 2)
  int levels;
  int64_t entries;
  const int32_t* resolutions;
  const float* level_table(int level) const { return table + level * entries * 2; }
};

struct Points {
  f8 v[3];
};

SOAR_INLINE Points load_points(const Grid& grid, int64_t first) {
  return {{load(grid.planar + first), load(grid.planar + grid.stride + first), load(grid.planar + 2 * grid.stride + first)}};
}

// The cells of eight points at one level, the place in each, and the entry of each corner.
struct Cells {
  f8 place[3];
  i8 base[3], step[3];  // entry of corner (i, j, k): combination of base + step where the bit is set
  i8 mask;
  bool dense;

  f8 weight(int corner) const {
    f8 w = splat(1.0f);
    for (int k = 0; k < 3; ++k) w *= corner >> k & 1 ? place[k] : splat(1.0f) - place[k];
    return w;
  }
  i8 entry(int corner) const {
    i8 e[3];
    for (int k = 0; k < 3; ++k) e[k] = corner >> k & 1 ? base[k] + step[k] : base[k];
    return dense ? e[0] + e[1] + e[2] : (e[0] ^ e[1] ^ e[2]) & mask;
  }
};

SOAR_INLINE Cells locate(const Grid& grid, const Points& points, int level) {
  const int64_t n = grid.resolutions[level];
  Cells c;
  c.dense = (n + 1) * (n + 1) * (n + 1) <= grid.entries;
  c.mask = splat_int((int32_t)(grid.entries - 1));
  // The three factors of Mueller et al.; unsigned products wrap, as the definition wants.
  const uint32_t factor[3] = {1u, c.dense ? (uint32_t)(n + 1) : 2654435761u, c.dense ? (uint32_t)((n + 1) * (n + 1)) : 805459861u};
  for (int k = 0; k < 3; ++k) {
    const f8 p = minimum(maximum(points.v[k], splat(0.0f)), splat(1.0f)) * splat((float)n);
    const f8 corner = minimum(floor(p), splat((float)(n - 1)));
    c.place[k] = p - corner;
    typedef uint32_t u8 __attribute__((vector_size(32)));
    const uint32_t f = factor[k];
    c.base[k] = (i8)((u8)to_int(corner) * u8{f, f, f, f, f, f, f, f});
    c.step[k] = splat_int((int32_t)f);
  }
  return c;
}

// Both features of four entries: f0 f1 f0 f1 ...
SOAR_INLINE f8 load_entries(const float* table, const uint32_t* entry) {
  typedef double d4 __attribute__((vector_size(32)));
  double v[4];
  for (int i = 0; i < 4; ++i) std::memcpy(&v[i], table + 2 * (int64_t)entry[i], 8);
  return (f8)d4{v[0], v[1], v[2], v[3]};
}

void encode_block(const Grid& grid, int64_t block, float* codes) {
  const int64_t begin = block * kBlock, end = begin + kBlock < grid.count ? begin + kBlock : grid.count;
  for (int level = 0; level < grid.levels; ++level) {
    const float* table = grid.level_table(level);
    for (int64_t first = begin; first < end; first += kLanes) {
      const Cells c = locate(grid, load_points(grid, first), level);
      f8 low = splat(0.0f), high = splat(0.0f);
      for (int corner = 0; corner < 8; ++corner) {
        const auto e = spill(c.entry(corner));
        const f8 w = c.weight(corner);
        low += twice_low(w) * load_entries(table, e.lane);
        high += twice_high(w) * load_entries(table, e.lane + 4);
      }
      float out[16];
      store(out, low);
      store(out + 8, high);
      for (int i = 0; i < kLanes && first + i < end; ++i)
        std::memcpy(codes + ((first + i) * grid.levels + level) * 2, out + 2 * i, 8);
    }
  }
}

// Upstream gradient of eight points at one level, f0 f1 f0 f1 ...; zero for lanes beyond the last point.
SOAR_INLINE void load_upstream(const Grid& grid, const float* upstream, int level, int64_t first, int64_t end, f8& low, f8& high) {
  float g[16] = {};
  for (int i = 0; i < kLanes && first + i < end; ++i)
    std::memcpy(g + 2 * i, upstream + ((first + i) * grid.levels + level) * 2, 8);
  low = load(g);
  high = load(g + 8);
}

void scatter_level(const Grid& grid, int level, const float* upstream, float* g_table) {
  float* out = g_table + level * grid.entries * 2;
  std::memset(out, 0, grid.entries * 2 * sizeof(float));
  for (int64_t first = 0; first < grid.count; first += kLanes) {
    const Cells c = locate(grid, load_points(grid, first), level);
    f8 low, high;
    load_upstream(grid, upstream, level, first, grid.count, low, high);
    for (int corner = 0; corner < 8; ++corner) {
      const auto e = spill(c.entry(corner));
      const f8 w = c.weight(corner);
      float add[16];
      store(add, twice_low(w) * low);
      store(add + 8, twice_high(w) * high);
      for (int i = 0; i < kLanes; ++i) {
        typedef float f2 __attribute__((vector_size(8)));
        f2 sum, more;
        float* to = out + 2 * (int64_t)e.lane[i];
        std::memcpy(&sum, to, sizeof sum);
        std::memcpy(&more, add + 2 * i, sizeof more);
        sum += more;
        std::memcpy(to, &sum, sizeof sum);
      }
    }
  }
}

void differentiate_block(const Grid& grid, int64_t block, const float* upstream, float* g_points) {
  const int64_t begin = block * kBlock, end = begin + kBlock < grid.count ? begin + kBlock : grid.count;
  f8 total[kBlock / kLanes][3] = {};
  for (int level = 0; level < grid.levels; ++level) {
    const float* table = grid.level_table(level);
    const f8 n = splat((float)grid.resolutions[level]);
    for (int64_t first = begin; first < end; first += kLanes) {
      const Cells c = locate(grid, load_points(grid, first), level);
      f8 low, high;
      load_upstream(grid, upstream, level, first, end, low, high);
      f8 v[8];  // what the loss would change by, were all weight on this corner
      for (int corner = 0; corner < 8; ++corner) {
        const auto e = spill(c.entry(corner));
        const f8 a = low * load_entries(table, e.lane), b = high * load_entries(table, e.lane + 4);
        v[corner] = SOAR_SHUFFLE2(a, b, 0, 2, 4, 6, 8, 10, 12, 14) + SOAR_SHUFFLE2(a, b, 1, 3, 5, 7, 9, 11, 13, 15);
      }
      // Trilinear interpolation, one axis after the other; the differences met on the way are the derivatives.
      f8 dx[4], x[4], dy[2], y[2];
      for (int i = 0; i < 4; ++i) dx[i] = v[2 * i + 1] - v[2 * i], x[i] = v[2 * i] + c.place[0] * dx[i];
      for (int i = 0; i < 2; ++i) dy[i] = x[2 * i + 1] - x[2 * i], y[i] = x[2 * i] + c.place[1] * dy[i];
      for (int i = 0; i < 2; ++i) dx[i] = dx[2 * i] + c.place[1] * (dx[2 * i + 1] - dx[2 * i]);
      f8* sum = total[(first - begin) / kLanes];
      sum[0] += n * (dx[0] + c.place[2] * (dx[1] - dx[0]));
      sum[1] += n * (dy[0] + c.place[2] * (dy[1] - dy[0]));
      sum[2] += n * (y[1] - y[0]);
    }
  }
  for (int64_t first = begin; first < end; first += kLanes) {
    const Points points = load_points(grid, first);
    for (int k = 0; k < 3; ++k) {
      const auto inside = (points.v[k] >= splat(0.0f)) & (points.v[k] <= splat(1.0f));  // flat outside the cube
      const f8 g = keep(inside, total[(first - begin) / kLanes][k]);
      for (int i = 0; i < kLanes && first + i < end; ++i) g_points[3 * (first + i) + k] = g[i];
    }
  }
}

// Points as three planes, for vector loads.
void to_planar(const float* points, int64_t count, Buffer<float>& planar, int64_t& stride) {
  stride = (count + kLanes - 1) / kLanes * kLanes;
  planar.need(3 * stride);
  for (int64_t i = 0; i < stride; ++i)
    for (int k = 0; k < 3; ++k) planar[k * stride + i] = points[3 * (i < count ? i : count - 1) + k];
}

}  // namespace
}  // namespace soar

#define SOAR_API extern "C" __attribute__((visibility("default")))

// Both return 0 when memory ran out.

// points (N, 3), table (levels, entries, 2) with a power of two entries, codes (N, 2 levels).
SOAR_API int soar_hash_forward(const float* points, int64_t count, const float* table, int levels, int64_t entries,
                               const int32_t* resolutions, float* codes, int threads) try {
  using namespace soar;
  Buffer<float> planar;
  int64_t stride;
  to_planar(points, count, planar, stride);
  const Grid grid = {planar.data(), stride, count, table, levels, entries, resolutions};
  Team team(threads);
  team.run((count + kBlock - 1) / kBlock, [&](int64_t block) { encode_block(grid, block, codes); });
  return 1;
} catch (const std::exception&) {
  return 0;
}

// Gradients of table and points; a null target is skipped.
SOAR_API int soar_hash_backward(const float* points, int64_t count, const float* table, int levels, int64_t entries,
                                const int32_t* resolutions, const float* upstream, float* g_table, float* g_points, int threads) try {
  using namespace soar;
  Buffer<float> planar;
  int64_t stride;
  to_planar(points, count, planar, stride);
  const Grid grid = {planar.data(), stride, count, table, levels, entries, resolutions};
  Team team(threads);
  if (g_table) team.run(levels, [&](int64_t level) { scatter_level(grid, (int)level, upstream, g_table); });
  if (g_points)
    team.run((count + kBlock - 1) / kBlock, [&](int64_t block) { differentiate_block(grid, block, upstream, g_points); });
  return 1;
} catch (const std::exception&) {
  return 0;
}
