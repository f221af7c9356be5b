// The z-buffers of a view, near and far, clothed and naked in one walk over the triangles; then the colours.
#include <algorithm>
#include <limits>
#include <memory>
#include <vector>

#include "people_steps.h"

namespace soar::people {
namespace {

constexpr float kAhead = 0.01f;  // metres: a face with a corner nearer to the camera is left out
constexpr int64_t kBandSamples = 1 << 17;  // of one side: its buffers stay in the second-level cache

// Where all corners of a triangle lie this far, in metres, inside or outside its layer, its inside is taken for granted.
constexpr float kSure = 0.012f;

struct Corner {
  double x, y, iz;  // samples, 1 / metres; double so that edge tests of neighbouring faces agree
};

struct Buffers {  // of one side of one band: nearness 1 / z and face of each sample
  std::vector<double> clothed, naked;
  std::vector<int32_t> clothed_face, naked_face;
};

enum State : uint8_t { kNone, kAll, kMixed };

struct Scene {
  const Geometry& g;
  const Person& person;
  const Dress& dressed;
  const Posed& posed;
  const Light& light;
  const View& view;
  std::vector<Corner> corners;
  std::vector<uint8_t> layer_of;   // of a triangle
  const float* attribute(int layer, int32_t vertex) const {
    return g.attributes + (int64_t)kAttributes * (g.group_point[g.layer_group[layer]] + vertex - g.layer_vertex[layer]);
  }
};

State state(const Scene& s, int layer, const int32_t* c) {
  if (layer == kEyes) return kAll;
  const float a = s.dressed.kept[c[0]], b = s.dressed.kept[c[1]], d = s.dressed.kept[c[2]];
  const float low = least(a, least(b, d)), high = most(a, most(b, d));
  return low > kSure ? kAll : high < -kSure ? kNone : kMixed;
}

void blend(const float* a, const float* b, const float* c, const double* w, float* out) {
  for (int k = 0; k < kAttributes; ++k) out[k] = (float)(w[0] * a[k] + w[1] * b[k] + w[2] * c[k]);
}

// Barycentrics of a sample by the corners' screen positions, perspective correct; false outside. Edges are inside.
SOAR_INLINE bool weigh(const Corner* v, double inverse_area, double x, double y, double* w, double& iz) {
  for (int k = 0; k < 3; ++k) {
    const Corner &p = v[(k + 1) % 3], &q = v[(k + 2) % 3];
    w[k] = ((q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x)) * inverse_area;
    if (w[k] < 0) return false;
  }
  iz = 0;
  for (int k = 0; k < 3; ++k) iz += w[k] *= v[k].iz;
  for (int k = 0; k < 3; ++k) w[k] /= iz;
  return true;
}

SOAR_INLINE double area_of(const Corner* v) {
  return (v[1].x - v[0].x) * (v[2].y - v[0].y) - (v[1].y - v[0].y) * (v[2].x - v[0].x);
}

void fill(const Scene& s, int top, int bottom, Buffers* near, Buffers* far) {
  const Geometry& g = s.g;
  const int width = s.view.width * s.view.samples;
  for (int layer = 0; layer < kLayers; ++layer) {
    if (!worn(s.person, layer)) continue;
    const bool skin = layer <= kEyes, open = !skin && layer != kShoes && layer != kHair;  // open layers show their inside
    for (int32_t t = g.layer_triangle[layer]; t < g.layer_triangle[layer + 1]; ++t) {
      const int32_t* c = g.corners + 3 * (int64_t)t;
      const Corner v[3] = {s.corners[c[0]], s.corners[c[1]], s.corners[c[2]]};
      if (!(v[0].iz > 0 && v[1].iz > 0 && v[2].iz > 0)) continue;
      const int y0 = std::max(top, (int)std::ceil(std::min({v[0].y, v[1].y, v[2].y}) - 0.5));
      const int y1 = std::min(bottom - 1, (int)std::floor(std::max({v[0].y, v[1].y, v[2].y}) - 0.5));
      if (y0 > y1) continue;
      const int x0 = std::max(0, (int)std::ceil(std::min({v[0].x, v[1].x, v[2].x}) - 0.5));
      const int x1 = std::min(width - 1, (int)std::floor(std::max({v[0].x, v[1].x, v[2].x}) - 0.5));
      if (x0 > x1) continue;
      const double area = area_of(v);
      if (!(area != 0)) continue;
      const double inverse_area = 1 / area;
      const bool facing = area < 0;  // counter-clockwise from outside, rows count downwards
      if (!open && !(facing ? near : far)) continue;
      const State kept = state(s, layer, c);
      if (kept == kNone && !skin) continue;
      for (int y = y0; y <= y1; ++y)
        for (int x = x0; x <= x1; ++x) {
          double w[3], iz;
          if (!weigh(v, inverse_area, x + 0.5, y + 0.5, w, iz)) continue;
          const int64_t i = (int64_t)(y - top) * width + x;
          int cut = kept == kMixed ? -1 : kept == kAll;  // -1: not known yet
          for (Buffers* b : {near, far}) {
            if (!b || (!open && (b == near) != facing)) continue;
            const bool nearest = b == near;
            if (skin && (nearest ? iz > b->naked[i] : iz < b->naked[i])) b->naked[i] = iz, b->naked_face[i] = t;
            if (nearest ? iz <= b->clothed[i] : iz >= b->clothed[i]) continue;
            if (cut < 0) {
              float a[kAttributes];
              blend(s.attribute(layer, c[0]), s.attribute(layer, c[1]), s.attribute(layer, c[2]), w, a);
              cut = keep(*g.anchors, s.person, layer, a) > 0;
            }
            if (cut) b->clothed[i] = iz, b->clothed_face[i] = t;
          }
        }
    }
  }
}

struct Hit {  // what a sample sees
  int layer;
  float attributes[kAttributes];
  double w[3];
  float z, sky, shadow, crease;
  V3 normal;  // world, smooth
  const int32_t* c;
};

Hit look(const Scene& s, int32_t t, int x, int y) {
  Hit h;
  h.layer = s.layer_of[t];
  h.c = s.g.corners + 3 * (int64_t)t;
  const Corner v[3] = {s.corners[h.c[0]], s.corners[h.c[1]], s.corners[h.c[2]]};
  double iz = 1;
  weigh(v, 1 / area_of(v), x + 0.5, y + 0.5, h.w, iz);
  h.z = (float)(1 / iz);
  const float* n = s.posed.normals;
  h.normal = unit(v3(n + 3 * h.c[0]) * (float)h.w[0] + v3(n + 3 * h.c[1]) * (float)h.w[1] + v3(n + 3 * h.c[2]) * (float)h.w[2]);
  blend(s.attribute(h.layer, h.c[0]), s.attribute(h.layer, h.c[1]), s.attribute(h.layer, h.c[2]), h.w, h.attributes);
  h.sky = h.shadow = h.crease = 0;
  for (int k = 0; k < 3; ++k) {
    const float w = (float)h.w[k];
    h.sky += w * s.posed.sky[h.c[k]], h.shadow += w * s.posed.shadow[h.c[k]];
    h.crease += w * s.posed.crease[h.c[k]];
  }
  return h;
}

// A relief's slope over rest positions, carried to the posed surface by the triangle's edges, tilts the normal.
V3 tilted(const Scene& s, const Hit& h, V3 slope) {
  const float *a = s.attribute(h.layer, h.c[0]), *b = s.attribute(h.layer, h.c[1]), *c = s.attribute(h.layer, h.c[2]);
  const float* p = s.posed.vertices;
  const V3 e1 = v3(p + 3 * h.c[1]) - v3(p + 3 * h.c[0]), e2 = v3(p + 3 * h.c[2]) - v3(p + 3 * h.c[0]);
  const float d1 = dot(slope, v3(b) - v3(a)), d2 = dot(slope, v3(c) - v3(a));
  const float g11 = dot(e1, e1), g12 = dot(e1, e2), g22 = dot(e2, e2), det = g11 * g22 - g12 * g12;
  if (!(det > 1e-14f)) return h.normal;
  V3 rise = e1 * ((d1 * g22 - d2 * g12) / det) + e2 * ((d2 * g11 - d1 * g12) / det);
  const float steep = length(rise);
  if (steep > 0.8f) rise = rise * (0.8f / steep);
  return unit(h.normal - rise);
}

V3 turned(const View& v, V3 n) {
  return {v.T[0] * n.x + v.T[1] * n.y + v.T[2] * n.z, v.T[4] * n.x + v.T[5] * n.y + v.T[6] * n.z,
          v.T[8] * n.x + v.T[9] * n.y + v.T[10] * n.z};
}

// Unit in camera space and on the drawn side: smooth normals may lean over the rim that they shade.
V3 facing_side(V3 n, bool front) {
  const float least_z = 0.02f;
  if (front ? n.z > -least_z : n.z < least_z) n.z = front ? -least_z : least_z;
  return unit(n);
}

float encoded(float linear) {  // sRGB
  const float x = clamp01(linear);
  return x <= 0.0031308f ? 12.92f * x : 1.055f * std::pow(x, 1 / 2.4f) - 0.055f;
}

void put(float* planes, int64_t size, int64_t at, V3 v) {
  planes[at] = v.x, planes[at + size] = v.y, planes[at + 2 * size] = v.z;
}

void resolve(const Scene& s, int row, int top, const Buffers& b, bool front, const Maps& out) {
  const View& view = s.view;
  const int n = view.samples, width = view.width * n;
  const int64_t size = (int64_t)view.width * view.height;
  const V3 eye = {-(view.T[0] * view.T[3] + view.T[4] * view.T[7] + view.T[8] * view.T[11]),
                  -(view.T[1] * view.T[3] + view.T[5] * view.T[7] + view.T[9] * view.T[11]),
                  -(view.T[2] * view.T[3] + view.T[6] * view.T[7] + view.T[10] * view.T[11])};
  for (int column = 0; column < view.width; ++column) {
    const int64_t at = (int64_t)row * view.width + column;
    V3 colour{0, 0, 0}, normal{0, 0, 0}, skin{0, 0, 0}, place{0, 0, 0};
    int covered = 0, naked = 0, layer = -1;
    double best = front ? 0 : std::numeric_limits<double>::infinity(), skin_best = best;
    for (int k = 0; k < n * n; ++k) {
      const int x = column * n + k % n, y = row * n + k / n;
      const int64_t i = (int64_t)(y - top) * width + x;
      if (b.clothed_face[i] >= 0) {
        ++covered;
        const Hit h = look(s, b.clothed_face[i], x, y);
        const float kept = h.layer <= kEyes ? 1 : keep(*s.g.anchors, s.person, h.layer, h.attributes);
        const Surface f = surface(*s.g.anchors, s.person, h.layer, h.attributes, kept, h.crease, h.z / view.fx / n);
        const V3 bent = tilted(s, h, f.slope);
        V3 seen = turned(view, bent);
        const bool inside = front ? turned(view, h.normal).z > 0.25f : turned(view, h.normal).z < -0.25f;
        if (inside) seen = seen * -1;
        seen = facing_side(seen, front);
        normal = normal + seen;
        if (out.colour) {
          const double* w = h.w;
          const float* p = s.posed.vertices;
          const V3 spot = v3(p + 3 * h.c[0]) * (float)w[0] + v3(p + 3 * h.c[1]) * (float)w[1] + v3(p + 3 * h.c[2]) * (float)w[2];
          const float inner = inside ? 0.45f : 1;  // the inside of a garment lies in its own shade
          colour = colour + lit(s.light, f, inside ? bent * -1 : bent, unit(eye - spot), h.sky * inner, h.shadow * inner);
        }
        if (front ? b.clothed[i] > best : b.clothed[i] < best) best = b.clothed[i], layer = h.layer;
      }
      if (b.naked_face[i] >= 0) {
        ++naked;
        const Hit h = look(s, b.naked_face[i], x, y);
        skin = skin + facing_side(turned(view, h.normal), front);
        if (front ? b.naked[i] > skin_best : b.naked[i] < skin_best)
          skin_best = b.naked[i], place = {h.attributes[kX], h.attributes[kY], h.attributes[kZ]};
      }
    }
    const float share = 1.0f / (n * n);
    if (out.colour) {
      const V3 c = covered ? colour * (1.0f / covered) : V3{0, 0, 0};
      put(out.colour, size, at, covered ? V3{encoded(c.x), encoded(c.y), encoded(c.z)} : c);
    }
    if (out.normal) put(out.normal, size, at, covered ? unit(normal) : normal);
    if (out.alpha) out.alpha[at] = covered * share;
    if (out.depth) out.depth[at] = covered ? (float)(1 / best) : 0;
    if (out.layer) out.layer[at] = layer;
    if (out.skin_normal) put(out.skin_normal, size, at, naked ? unit(skin) : skin);
    if (out.skin_alpha) out.skin_alpha[at] = naked * share;
    if (out.skin_depth) out.skin_depth[at] = naked ? (float)(1 / skin_best) : 0;
    if (out.place) put(out.place, size, at, place);
  }
}

}  // namespace

void draw(const Geometry& g, const Person& person, const Dress& dressed, const Posed& posed, const Light& light,
          const View& view, const Maps* front, const Maps* back, int threads) {
  Team team(threads);
  Scene s{g, person, dressed, posed, light, view, std::vector<Corner>(g.vertices), std::vector<uint8_t>(g.triangles)};
  for (int layer = 0; layer < kLayers; ++layer) {
    std::fill(s.layer_of.begin() + g.layer_triangle[layer], s.layer_of.begin() + g.layer_triangle[layer + 1], (uint8_t)layer);
    if (layer == kEyes || !worn(person, layer)) continue;
    const int group = g.layer_group[layer];
    const int64_t first = g.layer_vertex[layer], end = first + g.group_point[group + 1] - g.group_point[group];
    for (int64_t i = first; i < end; ++i) {
      const float *p = posed.vertices + 3 * i, *T = view.T;
      const double x = T[0] * p[0] + T[1] * p[1] + T[2] * p[2] + T[3], y = T[4] * p[0] + T[5] * p[1] + T[6] * p[2] + T[7];
      const double z = T[8] * p[0] + T[9] * p[1] + T[10] * p[2] + T[11], iz = z > kAhead ? 1 / z : 0;
      s.corners[i] = {view.samples * (view.fx * x * iz + view.cx), view.samples * (view.fy * y * iz + view.cy), iz};
    }
  }
  // Bands of rows are independent, and a sample's outcome does not depend on the band it lies in.
  const int64_t row_samples = (int64_t)view.width * view.samples * view.samples;
  const int rows = (int)std::clamp<int64_t>(kBandSamples / row_samples, 1, (view.height + threads - 1) / threads);
  team.run((view.height + rows - 1) / rows, [&](int64_t band) {
    const int first = (int)band * rows, last = std::min(first + rows, view.height);
    const int64_t samples = (int64_t)(last - first) * view.samples * view.width * view.samples;
    Buffers near, far;
    for (Buffers* b : {front ? &near : nullptr, back ? &far : nullptr}) {
      if (!b) continue;
      const double empty = b == &near ? 0 : std::numeric_limits<double>::infinity();
      b->clothed.assign(samples, empty), b->naked.assign(samples, empty);
      b->clothed_face.assign(samples, -1), b->naked_face.assign(samples, -1);
    }
    const int top = first * view.samples, bottom = last * view.samples;
    fill(s, top, bottom, front ? &near : nullptr, back ? &far : nullptr);
    for (int row = first; row < last; ++row) {
      if (front) resolve(s, row, top, near, true, *front);
      if (back) resolve(s, row, top, far, false, *back);
    }
  });
}

}  // namespace soar::people
