// Mesh z-buffer: the nearest or farthest face at each pixel centre, with perspective-correct barycentrics.
#include <cmath>
#include <limits>
#include <memory>

#include "surfels.h"

namespace soar {
namespace {

constexpr int kMeshBand = 16;  // pixel rows per job

struct Corner {
  double x, y, iz;  // pixels, 1 / metres; double so that edge tests of neighbouring faces agree to the last pixel
};

struct Rows {
  int32_t first, last;  // pixel rows whose centres a face's box contains; empty when first > last
};

struct Mesh {
  const float* vertices;
  const int64_t* faces;
  int64_t vertex_count, face_count;
  Camera camera;
  bool farthest;
  Buffer<Corner> corners;
  Buffer<Rows> rows;
};

void project_vertices(Mesh& m, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) {
    const float* v = m.vertices + 3 * i;
    const double iz = v[2] > kNear ? 1.0 / v[2] : 0.0;  // 0 marks a vertex that is not ahead
    m.corners[i] = {m.camera.fx * v[0] * iz + m.camera.cx, m.camera.fy * v[1] * iz + m.camera.cy, iz};
  }
}

void bound_faces(Mesh& m, int64_t begin, int64_t end) {
  for (int64_t f = begin; f < end; ++f) {
    m.rows[f] = {1, 0};
    const Corner &a = m.corners[m.faces[3 * f]], &b = m.corners[m.faces[3 * f + 1]], &c = m.corners[m.faces[3 * f + 2]];
    if (!(a.iz > 0 && b.iz > 0 && c.iz > 0)) continue;
    const double low = std::fmin(a.y, std::fmin(b.y, c.y)), high = std::fmax(a.y, std::fmax(b.y, c.y));
    if (!(low < m.camera.height && high > 0)) continue;
    m.rows[f] = {(int32_t)std::fmax(std::ceil(low - 0.5), 0), (int32_t)std::fmin(std::floor(high - 0.5), m.camera.height - 1)};
  }
}

void fill_band(const Mesh& m, int band, int32_t* face, float* barycentrics, float* depth) {
  const Camera& c = m.camera;
  const int top = band * kMeshBand, bottom = (top + kMeshBand < c.height ? top + kMeshBand : c.height) - 1;
  const int64_t begin = (int64_t)top * c.width, pixels = (int64_t)(bottom - top + 1) * c.width;
  std::unique_ptr<double[]> nearness(new double[pixels]);  // 1 / z
  for (int64_t i = 0; i < pixels; ++i) {
    nearness[i] = m.farthest ? std::numeric_limits<double>::infinity() : 0.0;
    face[begin + i] = -1;
    depth[begin + i] = std::numeric_limits<float>::infinity();
  }
  std::memset(barycentrics + 3 * begin, 0, 3 * pixels * sizeof(float));

  for (int64_t f = 0; f < m.face_count; ++f) {
    const int y0 = m.rows[f].first > top ? m.rows[f].first : top, y1 = m.rows[f].last < bottom ? m.rows[f].last : bottom;
    if (y0 > y1) continue;
    const Corner v[3] = {m.corners[m.faces[3 * f]], m.corners[m.faces[3 * f + 1]], m.corners[m.faces[3 * f + 2]]};
    const double area = (v[1].x - v[0].x) * (v[2].y - v[0].y) - (v[1].y - v[0].y) * (v[2].x - v[0].x);
    if (!(area != 0)) continue;
    const double low = std::fmin(v[0].x, std::fmin(v[1].x, v[2].x)), high = std::fmax(v[0].x, std::fmax(v[1].x, v[2].x));
    if (!(low < c.width && high > 0)) continue;
    const int x0 = (int)std::fmax(std::ceil(low - 0.5), 0), x1 = (int)std::fmin(std::floor(high - 0.5), c.width - 1);
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x) {
        double w[3];  // screen-space barycentrics; edges count as inside, so neighbours leave no gap
        bool inside = true;
        for (int k = 0; k < 3; ++k) {
          const Corner &p = v[(k + 1) % 3], &q = v[(k + 2) % 3];
          w[k] = ((q.x - p.x) * (y + 0.5 - p.y) - (q.y - p.y) * (x + 0.5 - p.x)) / area;
          inside = inside && w[k] >= 0;
        }
        if (!inside) continue;
        double iz = 0;
        for (int k = 0; k < 3; ++k) iz += w[k] *= v[k].iz;
        const int64_t i = (int64_t)(y - top) * c.width + x;
        // Strict comparison: of faces at equal depth the first in the list stays.
        if (m.farthest ? iz >= nearness[i] : iz <= nearness[i]) continue;
        nearness[i] = iz;
        face[begin + i] = (int32_t)f;
        depth[begin + i] = (float)(1 / iz);
        for (int k = 0; k < 3; ++k) barycentrics[3 * (begin + i) + k] = (float)(w[k] / iz);
      }
  }
}

}  // namespace
}  // namespace soar

// Arrays: vertices (V, 3) float32 camera space, faces (F, 3) int64, intrinsics fx fy cx cy. Returns 0 when memory ran out.
extern "C" __attribute__((visibility("default"))) int soar_mesh(const float* vertices, int64_t vertex_count, const int64_t* faces,
                                                                int64_t face_count, const float* intrinsics, int width, int height,
                                                                int farthest, int32_t* face, float* barycentrics, float* depth,
                                                                int threads) try {
  using namespace soar;
  Mesh m;
  m.vertices = vertices, m.faces = faces, m.vertex_count = vertex_count, m.face_count = face_count;
  m.camera = {intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3], width, height};
  m.farthest = farthest != 0;
  m.corners.need(vertex_count);
  m.rows.need(face_count);
  Team team(threads);
  auto chunks = [](int64_t count) { return (count + kChunk - 1) / kChunk; };
  auto end = [](int64_t chunk, int64_t count) { return (chunk + 1) * kChunk < count ? (chunk + 1) * kChunk : count; };
  team.run(chunks(vertex_count), [&](int64_t i) { project_vertices(m, i * kChunk, end(i, vertex_count)); });
  team.run(chunks(face_count), [&](int64_t i) { bound_faces(m, i * kChunk, end(i, face_count)); });
  team.run((height + kMeshBand - 1) / kMeshBand, [&](int64_t band) { fill_band(m, (int)band, face, barycentrics, depth); });
  return 1;
} catch (const std::exception&) {
  return 0;
}
