// Front-to-back composition of one job's tiles.
#include "surfels.h"

namespace soar {

void compose(const Context& t, int64_t job, float* planes) {
  const Camera& c = t.camera;
  const int columns = c.tiles_x(), band = t.band_of(job);
  const int64_t plane = (int64_t)c.width * c.height;
  const uint32_t* begin = &t.tile_begin[job * (int64_t)(columns * kBandTileRows + 1)];
  const uint32_t* pairs = t.pairs.data() + t.job_pair[job];
  const Record* records = t.near_records.data() + t.job_place[job];

  for (int row = 0; row < kBandTileRows; ++row) {
    const int y = (band * kBandTileRows + row) * kTileHeight;
    if (y >= c.height) break;
    for (int column = 0; column < columns; ++column) {
      const int tile = row * columns + column, x = column * kTileWidth;
      const f8 px = kLaneX + splat((float)x + 0.5f), py = kLaneY + splat((float)y + 0.5f);
      f8 transmittance = splat(1.0f), sums[8] = {};
      const uint32_t end = begin[tile + 1];
      for (uint32_t k = begin[tile]; k < end; ++k) {
        const Record& r = records[pairs[k]];
        if (k + kAhead < end) __builtin_prefetch(&records[pairs[k + kAhead]]);
        const Sample s = sample(r, px, py);
        const i8 open = transmittance > splat(kMinTransmittance);
        const i8 used = open & (s.alpha >= splat(kMinAlpha));
        if (!bits(used)) {
          if (!bits(open)) break;
          continue;
        }
        const f8 alpha = keep(used, s.alpha), w = transmittance * alpha;
        for (int i = 0; i < 3; ++i) sums[i] += w * splat(r.colour[i]);
        for (int i = 0; i < 3; ++i) sums[3 + i] += w * splat(r.normal[i]);
        sums[6] += w * (splat(r.z) + splat(r.zx) * s.dx + splat(r.zy) * s.dy);
        sums[7] += w * splat(r.occlusion);
        transmittance = transmittance - transmittance * alpha;
      }
      const bool whole = x + kTileWidth <= c.width && y + kTileHeight <= c.height;
      for (int i = 0; i < 7; ++i) store_tile(planes + i * plane, c, x, y, whole, sums[i]);
      store_tile(planes + 7 * plane, c, x, y, whole, splat(1.0f) - transmittance);  // the weights' sum
      store_tile(planes + 8 * plane, c, x, y, whole, sums[7]);
    }
  }
}

}  // namespace soar
