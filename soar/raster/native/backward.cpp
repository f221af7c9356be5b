// Gradient of one job's tiles, front to back again: the output itself holds what lies behind every surfel.
//
// With f the channels of a surfel, g the upstream gradient, phi = g . f and V = sum of w phi over the surfels not yet
// visited, dL/dalpha = T phi - V / (1 - alpha). V starts as g . output, so nothing is stored per pixel and surfel.
// The occlusion channel is left out of phi: its gradient reaches the surfels' occlusion and not their geometry.
#include "surfels.h"

namespace soar {
namespace {

// The sums over a tile's eight pixels are a product of the 8-vectors w and h with matrices that are constant over the
// tile: eight multiply-adds of a broadcast lane each. That beats a tree of shuffles and needs no shuffle at all.
struct TileMatrices {
  f8 gradient[kLanes];  // lane l: upstream gradient of pixel l; colour, normal, depth, occlusion
  f8 moments[kLanes];   // lane l: g_depth x, g_depth y (for w); 1, x, y, x^2, x y, y^2 (for h)
};

SOAR_INLINE f8 lane_of(const float* m, int i) {
  return f8{m[i], m[8 + i], m[16 + i], m[24 + i], m[32 + i], m[40 + i], m[48 + i], m[56 + i]};
}

void transpose(const f8 in[8], f8 out[8]) {
  float m[64];
  for (int i = 0; i < 8; ++i) store(m + 8 * i, in[i]);
  for (int i = 0; i < 8; ++i) out[i] = lane_of(m, i);
}

SOAR_INLINE void accumulate(Sums& sums, const TileMatrices& m, f8 w, f8 h, float ox, float oy) {
  const auto ws = spill(w), hs = spill(h);
  constexpr i8 first_two = {-1, -1, 0, 0, 0, 0, 0, 0};
  f8 a = splat(0.0f), b = splat(0.0f);
  for (int i = 0; i < kLanes; ++i) {
    a += splat(ws.lane[i]) * m.gradient[i];
    b += select(first_two, splat(ws.lane[i]), splat(hs.lane[i])) * m.moments[i];
  }
  // Moments about the tile's first pixel become moments about the surfel's centre, (ox, oy) pixels before it:
  // D_x = d_x + ox D, H_x = h_x + ox h, H_xx = h_xx + ox (h_x + H_x), H_xy = h_xy + ox h_y + oy H_x, and so in y.
  constexpr i8 in_x = {-1, 0, 0, -1, 0, -1, -1, 0}, moving = {-1, -1, 0, -1, -1, -1, -1, -1};
  constexpr i8 then_x = {0, 0, 0, 0, 0, -1, 0, 0}, second_order = {0, 0, 0, 0, 0, -1, -1, -1};
  const f8 x = splat(ox), y = splat(oy);
  b += keep(moving, select(in_x, x, y)) * select(first_two, SOAR_SHUFFLE(a, 6, 6, 6, 6, 6, 6, 6, 6), SOAR_SHUFFLE(b, 0, 1, 2, 2, 2, 3, 4, 4));
  b += keep(second_order, select(then_x, x, y)) * SOAR_SHUFFLE(b, 0, 1, 2, 3, 4, 3, 3, 4);
  float* total = sums.colour;
  store(total, load(total) + a);
  store(total + 8, load(total + 8) + b);
}

}  // namespace

void gather(Context& t, int64_t job, const float* planes, const float* gradient) {
  const Camera& c = t.camera;
  const int columns = c.tiles_x(), band = t.band_of(job);
  const int64_t plane = (int64_t)c.width * c.height;
  const uint32_t first = t.job_place[job], count = t.job_place[job + 1] - first;
  if (!count) return;
  const uint32_t* begin = &t.tile_begin[job * (int64_t)(columns * kBandTileRows + 1)];
  const uint32_t* pairs = t.pairs.data() + t.job_pair[job];
  const Record* records = t.near_records.data() + first;
  Sums* sums = t.sums.data() + first;
  std::memset((void*)sums, 0, count * sizeof(Sums));

  for (int row = 0; row < kBandTileRows; ++row) {
    const int y = (band * kBandTileRows + row) * kTileHeight;
    if (y >= c.height) break;
    for (int column = 0; column < columns; ++column) {
      const int tile = row * columns + column, x = column * kTileWidth;
      if (begin[tile] == begin[tile + 1]) continue;
      const bool whole = x + kTileWidth <= c.width && y + kTileHeight <= c.height;
      f8 g[9], behind = splat(0.0f);
      for (int i = 0; i < 9; ++i) {
        g[i] = load_tile(gradient + i * plane, c, x, y, whole);
        if (i < 8) behind += g[i] * load_tile(planes + i * plane, c, x, y, whole);
      }
      const f8 upstream[8] = {g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[8]};
      const f8 one = splat(1.0f);
      const f8 moments[8] = {g[6] * kLaneX, g[6] * kLaneY, one, kLaneX, kLaneY, kLaneX * kLaneX, kLaneX * kLaneY, kLaneY * kLaneY};
      TileMatrices m;
      transpose(upstream, m.gradient);
      transpose(moments, m.moments);

      const float left = (float)x + 0.5f, top = (float)y + 0.5f;
      const f8 px = kLaneX + splat(left), py = kLaneY + splat(top);
      f8 transmittance = one;
      const uint32_t end = begin[tile + 1];
      for (uint32_t k = begin[tile]; k < end; ++k) {
        const uint32_t place = pairs[k];
        const Record& r = records[place];
        if (k + kAhead < end) {
          __builtin_prefetch(&records[pairs[k + kAhead]]);
          __builtin_prefetch(&sums[pairs[k + kAhead]], 1);
        }
        const Sample s = sample(r, px, py);
        const i8 open = transmittance > splat(kMinTransmittance);
        const i8 used = open & (s.alpha >= splat(kMinAlpha));
        if (!bits(used)) {
          if (!bits(open)) break;
          continue;
        }
        const f8 alpha = keep(used, s.alpha), w = transmittance * alpha;
        f8 phi = g[7] + g[6] * (splat(r.z) + splat(r.zx) * s.dx + splat(r.zy) * s.dy);
        for (int i = 0; i < 3; ++i) phi += g[i] * splat(r.colour[i]) + g[3 + i] * splat(r.normal[i]);
        behind -= w * phi;
        const f8 slope = transmittance * phi - behind / (one - alpha);
        // No gradient passes through the clamp of alpha.
        const f8 h = keep(s.raw < splat(kMaxAlpha), alpha * slope);
        accumulate(sums[place], m, w, h, left - r.mx, top - r.my);
        transmittance = transmittance - transmittance * alpha;
      }
    }
  }
}

}  // namespace soar
