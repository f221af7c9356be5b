// Projects surfels, drops those that no pixel sees, and deals the rest out to the bands they touch.
#include "surfels.h"

namespace soar {
namespace {

// Largest and smallest pixel index whose centre lies within `extent` of `centre`, clipped to [0, size - 1]. Clipping
// happens before the conversion, so no float overflows an integer.
SOAR_INLINE i8 first_pixel(f8 centre, f8 extent) {
  const f8 edge = centre - extent - splat(0.5f);
  return to_int(minimum(maximum(-floor(-edge), splat(0.0f)), splat(1e6f)));
}
SOAR_INLINE i8 last_pixel(f8 centre, f8 extent, int size) {
  const f8 edge = centre + extent - splat(0.5f);
  return to_int(maximum(minimum(floor(edge), splat((float)(size - 1))), splat(-1.0f)));
}

void project_chunk(Context& t, const Surfels& in, int64_t chunk) {
  const Camera& c = t.camera;
  const int64_t begin = chunk * kChunk, end = begin + kChunk < in.count ? begin + kChunk : in.count;
  uint32_t* slots = &t.chunk_slots[chunk * t.jobs];
  uint32_t* pairs = &t.chunk_pairs[chunk * t.jobs];
  std::memset(slots, 0, t.jobs * sizeof(uint32_t));
  std::memset(pairs, 0, t.jobs * sizeof(uint32_t));
  int64_t out = begin;
  for (int64_t first = begin; first < end; first += kLanes) {
    const int count = end - first < kLanes ? (int)(end - first) : kLanes;
    f8 x, y, z = splat(0.0f), n0, n1, n2, s;
    x = y = n0 = n1 = n2 = s = z;  // unused lanes have z = 0 and are dropped as being behind the camera
    for (int i = 0; i < count; ++i) {
      const float *p = in.positions + 3 * (first + i), *n = in.normals + 3 * (first + i);
      x[i] = p[0], y[i] = p[1], z[i] = p[2], n0[i] = n[0], n1[i] = n[1], n2[i] = n[2], s[i] = in.scales[first + i];
    }
    const Projection p = project(c, t.filter, x, y, z, n0, n1, n2, s);
    const i8 ahead = z > splat(kNear);
    const i8 facing = p.cosine < splat(0.0f), averted = p.cosine > splat(0.0f);
    // Comparisons are written so that a NaN fails them: a broken surfel is dropped, not splatted everywhere.
    const i8 visible = ahead & (p.opacity >= splat(kMinAlpha)) & (p.det > splat(0.0f));
    i8 wanted = splat_int(t.passes);
    if (t.filter.cull) wanted &= (facing & splat_int(kFront)) | (averted & splat_int(kBack));

    const f8 mx = splat(c.fx) * p.a + splat(c.cx), my = splat(c.fy) * p.b + splat(c.cy);
    // Box of the ellipse alpha = 1/255, a hair too large; the pixel's own test decides.
    const f8 reach = maximum(splat(2.0f * kLn2) * log2_above(p.opacity * splat(255.0f)), splat(0.0f));
    const f8 h = splat(t.filter.lowpass), hair = splat(1e-3f);
    const f8 ex = square_root(reach * (p.s11 + h)) + hair, ey = square_root(reach * (p.s22 + h)) + hair;
    const i8 x0 = first_pixel(mx, ex), x1 = last_pixel(mx, ex, c.width);
    const i8 y0 = first_pixel(my, ey), y1 = last_pixel(my, ey, c.height);
    const i8 inside = visible & (x0 <= x1) & (y0 <= y1) & (wanted != splat_int(0)) & (ex < splat(1e9f)) & (ey < splat(1e9f));
    unsigned todo = bits(inside);
    if (!todo) continue;

    const f8 clamped = slope_cosine(p.cosine);
    const f8 columns[9] = {mx, my,
                           splat(-0.5f * kLog2e) * (p.s22 + h) * p.inverse_det,
                           splat(kLog2e) * p.s12 * p.inverse_det,
                           splat(-0.5f * kLog2e) * (p.s11 + h) * p.inverse_det,
                           p.opacity,
                           z,
                           -z * n0 / (splat(c.fx) * clamped),
                           -z * n1 / (splat(c.fy) * clamped)};
    for (; todo; todo &= todo - 1, ++out) {
      const int i = __builtin_ctz(todo);
      const int64_t id = first + i;
      Record& r = t.records[out];
      r.mx = columns[0][i], r.my = columns[1][i], r.A = columns[2][i], r.B = columns[3][i], r.C = columns[4][i];
      r.opacity = columns[5][i];
      for (int k = 0; k < 3; ++k) r.colour[k] = in.colours[3 * id + k], r.normal[k] = in.normals[3 * id + k];
      r.z = columns[6][i], r.occlusion = in.occlusion[id], r.zx = columns[7][i], r.zy = columns[8][i];
      const Box box = {(uint16_t)(x0[i] / kTileWidth), (uint16_t)(y0[i] / kTileHeight),
                       (uint16_t)(x1[i] / kTileWidth), (uint16_t)(y1[i] / kTileHeight)};
      t.boxes[out] = box;
      t.ids[out] = (uint32_t)id;
      std::memcpy(&t.keys[out], &r.z, 4);  // bits of positive floats order like the floats
      t.sides[out] = (uint8_t)wanted[i];
      const int wide = box.x1 - box.x0 + 1;
      for (int pass = kFront; pass <= kBack; ++pass) {
        if (!(wanted[i] & pass)) continue;
        for (int band = box.y0 / kBandTileRows; band <= box.y1 / kBandTileRows; ++band) {
          const int top = band * kBandTileRows, bottom = top + kBandTileRows - 1;
          const int rows = (box.y1 < bottom ? box.y1 : bottom) - (box.y0 > top ? box.y0 : top) + 1;
          const int64_t job = t.first_job(pass) + band;
          ++slots[job];
          pairs[job] += (uint32_t)(wide * rows);
        }
      }
    }
  }
  t.chunk_seen[chunk] = (uint32_t)(out - begin);
}

// Turns counts into first positions: of each job's places and pairs, of each chunk's slots, and of each chunk's
// places within each job (written over chunk_slots).
void lay_out(Context& t) {
  t.job_place.need(t.jobs + 1);
  t.job_pair.need(t.jobs + 1);
  uint64_t place = 0, pair = 0;
  for (int64_t chunk = 0; chunk < t.chunks; ++chunk) t.slot_begin[chunk] = 0;
  for (int64_t job = 0; job < t.jobs; ++job) {
    t.job_place[job] = (uint32_t)place;
    t.job_pair[job] = pair;
    for (int64_t chunk = 0; chunk < t.chunks; ++chunk) {
      uint32_t& slots = t.chunk_slots[chunk * t.jobs + job];
      t.slot_begin[chunk] += slots;
      const uint32_t here = slots;
      slots = (uint32_t)place;
      place += here;
      pair += t.chunk_pairs[chunk * t.jobs + job];
    }
    // 32-bit places and pairs: gigabytes of lists, reached only by surfels that each cover the whole image.
    if (place > UINT32_MAX || pair - t.job_pair[job] > UINT32_MAX) throw std::bad_alloc();
  }
  t.job_place[t.jobs] = (uint32_t)place;
  t.job_pair[t.jobs] = pair;
  uint32_t slot = 0;
  for (int64_t chunk = 0; chunk < t.chunks; ++chunk) {
    const uint32_t here = t.slot_begin[chunk];
    t.slot_begin[chunk] = slot;
    slot += here;
  }
}

void deal_chunk(Context& t, int64_t chunk) {
  uint32_t* next = &t.chunk_slots[chunk * t.jobs];
  uint32_t slot = t.slot_begin[chunk];
  const int64_t begin = chunk * kChunk;
  for (int64_t seen = begin; seen < begin + t.chunk_seen[chunk]; ++seen) {
    const Box box = t.boxes[seen];
    for (int pass = kFront; pass <= kBack; ++pass) {
      if (!(t.sides[seen] & pass)) continue;
      // The back pass composes the farthest surfel first: the same ascending sort of the complemented key.
      const uint64_t key = pass == kFront ? t.keys[seen] : ~t.keys[seen];
      for (int band = box.y0 / kBandTileRows; band <= box.y1 / kBandTileRows; ++band, ++slot) {
        t.owner[slot] = (uint32_t)seen;
        t.entries[next[t.first_job(pass) + band]++] = key << 32 | slot;
      }
    }
  }
}

}  // namespace

void prepare(Context& t, const Surfels& in, Team& team) {
  t.chunks = (in.count + kChunk - 1) / kChunk;
  t.jobs = (int64_t)t.camera.bands() * (t.passes == (kFront | kBack) ? 2 : 1);
  t.records.need(in.count);
  t.boxes.need(in.count);
  t.ids.need(in.count);
  t.keys.need(in.count);
  t.sides.need(in.count);
  t.chunk_seen.need(t.chunks);
  t.slot_begin.need(t.chunks);
  t.chunk_slots.need(t.chunks * t.jobs);
  t.chunk_pairs.need(t.chunks * t.jobs);
  team.run(t.chunks, [&](int64_t chunk) { project_chunk(t, in, chunk); });

  lay_out(t);
  const uint32_t slots = t.job_place[t.jobs];
  t.owner.need(slots);
  t.place.need(slots);
  t.entries.need(slots);
  t.entries_other.need(slots);
  t.near_records.need(slots);
  t.near_boxes.need(slots);
  t.pairs.need(t.job_pair[t.jobs]);
  t.tile_begin.need(t.jobs * (int64_t)(t.camera.tiles_x() * kBandTileRows + 1));
  team.run(t.chunks, [&](int64_t chunk) { deal_chunk(t, chunk); });
}

}  // namespace soar
