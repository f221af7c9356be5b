// Shared by the forward and backward passes of the surfel rasteriser; soar/raster/reference.py states the mathematics.
//
// The image is cut into micro-tiles of 4 x 2 pixels, one vector register each: body surfels are smaller than a pixel or
// two, so larger tiles would mostly evaluate pixels that a surfel does not reach. Rows of micro-tiles form bands of
// fixed height. One job handles one band of one pass (front or back): it sorts its own surfels by depth, copies their
// records next to each other, lists them per tile, and walks the tiles. Jobs share nothing that is written, so there
// are no atomics, and results do not depend on the number of threads.
#pragma once

#include "simd.h"
#include "team.h"

namespace soar {

constexpr int kTileWidth = 4, kTileHeight = 2;
constexpr int kBandTileRows = 8;  // 16 pixel rows: records and gradients of a band stay in the second-level cache
constexpr int kChunk = 2048;      // surfels per job of the per-surfel phases
constexpr uint32_t kAhead = 8;    // records fetched this long before their use: they lie scattered in memory

constexpr float kNear = 0.01f;                // metres
constexpr float kMinAlpha = 1.0f / 255.0f;    // contributions below are dropped
constexpr float kMaxAlpha = 0.99f;
constexpr float kMinTransmittance = 1e-4f;    // a pixel at or below takes nothing more
constexpr float kMinSlopeCosine = 0.1f;       // grazing disks would otherwise throw depth by metres
constexpr float kLog2e = 1.44269504f, kLn2 = 0.69314718f;

constexpr int kFront = 1, kBack = 2;  // passes, as bits

struct Camera {
  float fx, fy, cx, cy;
  int width, height;
  int tiles_x() const { return (width + kTileWidth - 1) / kTileWidth; }
  int tiles_y() const { return (height + kTileHeight - 1) / kTileHeight; }
  int bands() const { return (tiles_y() + kBandTileRows - 1) / kBandTileRows; }
};

struct Filter {
  float lowpass;  // square pixels
  bool compensate, cull;
};

struct Surfels {
  const float *positions, *normals, *scales, *colours, *occlusion;
  int64_t count;
};

struct alignas(64) Record {  // what a pixel needs of a surfel: one cache line
  float mx, my;              // centre, pixels
  float A, B, C;             // log2 of the footprint: A dx^2 + B dx dy + C dy^2
  float opacity;
  float colour[3], normal[3], z, occlusion;
  float zx, zy;  // slope of the depth per pixel
};

struct alignas(64) Sums {  // what a surfel's gradient needs of its pixels, h = alpha dL/dalpha, w = blending weight
  float colour[3], normal[3], depth, occlusion;  // sums of w times the upstream gradient
  float depth_dx, depth_dy;                      // sums of w g_depth dx, w g_depth dy
  float h, hx, hy, hxx, hxy, hyy;                // moments of h about the surfel's centre
};

struct Box {  // micro-tile columns and rows, inclusive
  uint16_t x0, y0, x1, y1;
};

// Everything the backward pass needs of the forward pass, and its working memory. Contexts are pooled.
struct Context {
  Camera camera;
  Filter filter;
  int passes;
  int64_t chunks, jobs;

  // Per surfel that is seen, chunk c at c * kChunk. A seen surfel has one slot per (pass, band) it touches.
  Buffer<Record> records;
  Buffer<Box> boxes;
  Buffer<uint32_t> ids, keys;
  Buffer<uint8_t> sides;
  Buffer<uint32_t> chunk_seen;                // seen surfels of a chunk
  Buffer<uint32_t> chunk_slots, chunk_pairs;  // [chunk][job]: slots and (surfel, tile) pairs
  Buffer<uint32_t> slot_begin;                // first slot of a chunk

  // Per slot. Slots are numbered by surfel; places are grouped by job and sorted by depth.
  Buffer<uint32_t> owner, place;
  Buffer<uint64_t> entries, entries_other;  // depth key and slot, to sort
  Buffer<Record> near_records;              // by place
  Buffer<Box> near_boxes;
  Buffer<Sums> sums;

  // Per job and per tile.
  Buffer<uint32_t> job_place;                // first place of a job, one more than there are jobs
  Buffer<uint64_t> job_pair;                 // first pair of a job, likewise
  Buffer<uint32_t> tile_begin;               // [job][tile of the band + 1], relative to the job's first pair
  Buffer<uint32_t> pairs;                    // place relative to the job's first, in order of depth

  int pass_of(int64_t job) const { return passes == (kFront | kBack) ? (job < camera.bands() ? kFront : kBack) : passes; }
  int band_of(int64_t job) const { return (int)(job % camera.bands()); }
  int64_t first_job(int pass) const { return passes == (kFront | kBack) && pass == kBack ? camera.bands() : 0; }
};

// The affine image of a disk, for eight surfels. Names follow soar/raster/reference.py.
struct Projection {
  f8 a, b, iz, k1, k2, u1, u2, cosine, s11, s12, s22, area, det, inverse_det, opacity;
};

SOAR_INLINE Projection project(const Camera& c, const Filter& f, f8 x, f8 y, f8 z, f8 n0, f8 n1, f8 n2, f8 s) {
  Projection p;
  p.iz = splat(1.0f) / z;
  p.a = x * p.iz;
  p.b = y * p.iz;
  p.k1 = s * p.iz * splat(c.fx);
  p.k2 = s * p.iz * splat(c.fy);
  p.u1 = n0 - p.a * n2;
  p.u2 = n1 - p.b * n2;
  p.cosine = n0 * p.a + n1 * p.b + n2;
  p.s11 = p.k1 * p.k1 * (splat(1.0f) + p.a * p.a - p.u1 * p.u1);
  p.s12 = p.k1 * p.k2 * (p.a * p.b - p.u1 * p.u2);
  p.s22 = p.k2 * p.k2 * (splat(1.0f) + p.b * p.b - p.u2 * p.u2);
  p.area = p.k1 * p.k2 * absolute(p.cosine);
  const f8 h = splat(f.lowpass);
  // Sums of positive terms: the textbook s11 s22 - s12^2 cancels for edge-on disks.
  p.det = p.area * p.area + h * (p.s11 + p.s22) + h * h;
  p.inverse_det = splat(1.0f) / p.det;
  p.opacity = f.compensate ? p.area * square_root(p.inverse_det) : splat(1.0f);
  return p;
}

// Cosine of the depth slope: kept away from zero, sign included.
SOAR_INLINE f8 slope_cosine(f8 cosine) {
  const f8 size = maximum(absolute(cosine), splat(kMinSlopeCosine));
  return select(cosine < splat(0.0f), -size, size);
}

// Eight pixels of one micro-tile against one surfel.
struct Sample {
  f8 dx, dy, raw, alpha, depth;
};

SOAR_INLINE Sample sample(const Record& r, f8 px, f8 py) {
  Sample s;
  s.dx = px - splat(r.mx);
  s.dy = py - splat(r.my);
  const f8 power = s.dx * (splat(r.A) * s.dx + splat(r.B) * s.dy) + splat(r.C) * s.dy * s.dy;
  s.raw = splat(r.opacity) * exp2(maximum(power, splat(-60.0f)));
  s.alpha = minimum(s.raw, splat(kMaxAlpha));
  return s;
}

// Pixel centres of a micro-tile relative to its first one: lanes 0-3 the upper row, lanes 4-7 the lower.
constexpr f8 kLaneX = {0, 1, 2, 3, 0, 1, 2, 3};
constexpr f8 kLaneY = {0, 0, 0, 0, 1, 1, 1, 1};

// One micro-tile of a plane; `whole` is false where it hangs over the right or lower edge.
SOAR_INLINE f8 load_tile(const float* plane, const Camera& c, int x, int y, bool whole) {
  float v[kLanes] = {};
  if (whole) {
    std::memcpy(v, plane + (int64_t)y * c.width + x, 16);
    std::memcpy(v + 4, plane + (int64_t)(y + 1) * c.width + x, 16);
  } else {
    for (int i = 0; i < kLanes; ++i)
      if (x + i % 4 < c.width && y + i / 4 < c.height) v[i] = plane[(int64_t)(y + i / 4) * c.width + x + i % 4];
  }
  return load(v);
}

SOAR_INLINE void store_tile(float* plane, const Camera& c, int x, int y, bool whole, f8 value) {
  float v[kLanes];
  store(v, value);
  if (whole) {
    std::memcpy(plane + (int64_t)y * c.width + x, v, 16);
    std::memcpy(plane + (int64_t)(y + 1) * c.width + x, v + 4, 16);
  } else {
    for (int i = 0; i < kLanes; ++i)
      if (x + i % 4 < c.width && y + i / 4 < c.height) plane[(int64_t)(y + i / 4) * c.width + x + i % 4] = v[i];
  }
}

// prepare.cpp: per-surfel phase and distribution of surfels over the jobs.
void prepare(Context& context, const Surfels& surfels, Team& team);

// bin.cpp: sort, copy and list the surfels of one job.
void bin(Context& context, int64_t job);

// forward.cpp: the nine planes of one job's band; `planes` is its pass's image.
void compose(const Context& context, int64_t job, float* planes);

// backward.cpp: Sums of one job's places, from its pass's image and the gradient of that.
void gather(Context& context, int64_t job, const float* planes, const float* gradient);

struct Gradients {  // as the surfels' arrays
  float *positions, *normals, *scales, *colours, *occlusion;
};

// chain.cpp: from Sums to the gradients of one chunk's surfels. `passes` are those whose Sums are there.
void chain(const Context& context, int64_t chunk, int passes, const Surfels& surfels, const Gradients& out);

}  // namespace soar
