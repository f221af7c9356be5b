// Shape, pose, layers pushed out, and the light that reaches each vertex.
#include <vector>

#include "people_steps.h"

namespace soar::people {
namespace {

struct Bone {  // [G | t - G J] of soar/body/lbs.py
  float m[12];
};

void rodrigues(const float* v, float* R) {
  const float angle = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  const float a = angle < 1e-4f ? 1 - angle * angle / 6 : std::sin(angle) / angle;
  const float b = angle < 1e-4f ? 0.5f : (1 - std::cos(angle)) / (angle * angle);
  const float x = v[0], y = v[1], z = v[2];
  R[0] = 1 - b * (y * y + z * z), R[1] = b * x * y - a * z, R[2] = b * x * z + a * y;
  R[3] = b * x * y + a * z, R[4] = 1 - b * (x * x + z * z), R[5] = b * y * z - a * x;
  R[6] = b * x * z - a * y, R[7] = b * y * z + a * x, R[8] = 1 - b * (x * x + y * y);
}

// Rest joints (J) of a shape, and the chain of soar/body/lbs.py; `placed` are the posed joints.
void chain(const Geometry& g, const float* betas, const float* pose, const float* translation, std::vector<Bone>& bones,
           std::vector<V3>& placed) {
  std::vector<V3> rest(g.joints);
  for (int j = 0; j < g.joints; ++j) {
    float out[3];
    for (int i = 0; i < 3; ++i) {
      out[i] = g.joint_template[3 * j + i];
      for (int b = 0; b < g.betas; ++b) out[i] += g.joint_shapedirs[(3 * j + i) * g.betas + b] * betas[b];
    }
    rest[j] = v3(out);
    float R[9];
    rodrigues(pose + 3 * j, R);
    float* m = bones[j].m;
    const int up = g.parents[j];
    if (up < 0) {
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) m[4 * r + c] = R[3 * r + c];
      placed[j] = rest[j] + v3(translation);
    } else {
      const float* p = bones[up].m;
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) m[4 * r + c] = p[4 * r] * R[c] + p[4 * r + 1] * R[3 + c] + p[4 * r + 2] * R[6 + c];
      const V3 d = rest[j] - rest[up];
      placed[j] = placed[up] + V3{p[0] * d.x + p[1] * d.y + p[2] * d.z, p[4] * d.x + p[5] * d.y + p[6] * d.z,
                                  p[8] * d.x + p[9] * d.y + p[10] * d.z};
    }
    const V3 J = rest[j];
    m[3] = placed[j].x - (m[0] * J.x + m[1] * J.y + m[2] * J.z);
    m[7] = placed[j].y - (m[4] * J.x + m[5] * J.y + m[6] * J.z);
    m[11] = placed[j].z - (m[8] * J.x + m[9] * J.y + m[10] * J.z);
  }
}

void add_normals(const int32_t* corners, int64_t begin, int64_t end, const V3* vertices, V3* normals) {
  for (int64_t t = begin; t < end; ++t) {
    const int32_t a = corners[3 * t], b = corners[3 * t + 1], c = corners[3 * t + 2];
    const V3 n = cross(vertices[b] - vertices[a], vertices[c] - vertices[a]);
    normals[a] = normals[a] + n, normals[b] = normals[b] + n, normals[c] = normals[c] + n;
  }
}

struct Capsule {
  V3 a, b;
  float radius;
};

// The vertices that need light, eight at a time.
struct Receivers {
  std::vector<int32_t> vertex;
  std::vector<float> x, y, z, nx, ny, nz, sky, shadow;
  void add(int32_t v, V3 p, V3 n) {
    vertex.push_back(v);
    x.push_back(p.x), y.push_back(p.y), z.push_back(p.z), nx.push_back(n.x), ny.push_back(n.y), nz.push_back(n.z);
  }
  void pad() {
    const size_t count = (vertex.size() + kLanes - 1) / kLanes * kLanes;
    for (auto* values : {&x, &y, &z, &nx, &ny, &nz}) values->resize(count, 0.0f);
    sky.assign(count, 1), shadow.assign(count, 1);
  }
};

SOAR_INLINE f8 clamp01(f8 t) { return minimum(maximum(t, splat(0)), splat(1)); }

// The sphere at each capsule's nearest point takes its share of the sky; that of the vertex's own limb does not count.
// Then the capsule's soft shadow on the ray towards the key light l, by the closest points of ray and axis.
void shade(const Capsule& c, V3 l, Receivers& r) {
  const V3 d = c.b - c.a;
  const float dd = dot(d, d), dl = dot(d, l), inverse = 1 / most(dd, 1e-9f), det = 1 / most(dd - dl * dl, 1e-9f);
  const float r2 = c.radius * c.radius;
  for (size_t i = 0; i < r.x.size(); i += kLanes) {
    const f8 px = load(&r.x[i]) - splat(c.a.x), py = load(&r.y[i]) - splat(c.a.y), pz = load(&r.z[i]) - splat(c.a.z);
    const f8 along = px * splat(d.x) + py * splat(d.y) + pz * splat(d.z);
    const f8 t = clamp01(along * splat(inverse));
    const f8 dx = t * splat(d.x) - px, dy = t * splat(d.y) - py, dz = t * splat(d.z) - pz;
    const f8 square = maximum(dx * dx + dy * dy + dz * dz, splat(1e-12f)), radii = square * splat(1 / r2);
    const f8 across = load(&r.nx[i]) * dx + load(&r.ny[i]) * dy + load(&r.nz[i]) * dz;
    const f8 cosine = maximum(across / square_root(square), splat(0));
    const f8 far = clamp01((radii - splat(1.2f)) * splat(4));  // fades in, lest the shade have an edge
    store(&r.sky[i], load(&r.sky[i]) * (splat(1) - splat(0.9f) * far * cosine / maximum(radii, splat(1))));

    const f8 up = px * splat(l.x) + py * splat(l.y) + pz * splat(l.z);
    const f8 s = clamp01((along - up * splat(dl)) * splat(det)), ray = s * splat(dl) - up, ahead = maximum(ray, splat(0));
    const f8 gx = px + ahead * splat(l.x) - s * splat(d.x), gy = py + ahead * splat(l.y) - s * splat(d.y);
    const f8 gz = pz + ahead * splat(l.z) - s * splat(d.z);
    const f8 gap = square_root(gx * gx + gy * gy + gz * gz) * splat(1 / c.radius);
    const f8 open = clamp01((gap - splat(0.6f)) / (splat(0.4f) + splat(0.5f) * ahead));
    const f8 free = open * open * (splat(3) - splat(2) * open);
    const f8 matters = soar::keep(ray > splat(0), clamp01((radii - splat(1.7f)) * splat(2)));
    store(&r.shadow[i], minimum(load(&r.shadow[i]), splat(1) - matters * (splat(1) - free)));
  }
}

}  // namespace

void dress(const Geometry& g, const Person& person, const float* betas, Dress out) {
  const int64_t numbers = 3 * (int64_t)g.points;
  std::memcpy(out.rest, g.template_, numbers * sizeof(float));
  for (int b = 0; b < g.betas; ++b) {
    const float *direction = g.shapedirs + b * numbers, beta = betas[b];
    for (int64_t i = 0; i < numbers; ++i) out.rest[i] += beta * direction[i];
  }
  for (int layer = 0; layer < kLayers; ++layer) {
    if (layer == kEyes || !worn(person, layer)) continue;
    const int group = g.layer_group[layer];
    const float* a = g.attributes + (int64_t)kAttributes * g.group_point[group];
    const int64_t first = g.layer_vertex[layer], count = g.group_point[group + 1] - g.group_point[group];
    for (int64_t i = 0; i < count; ++i) {
      out.kept[first + i] = keep(*g.anchors, person, layer, a + kAttributes * i);
      out.push[first + i] = push(*g.anchors, person, layer, a + kAttributes * i, out.kept[first + i]);
    }
  }
}

void pose(const Geometry& g, const Person& person, const Dress& dressed, const float* betas, const float* axis_angles,
          const float* translation, const Light& light, Posed out) {
  std::vector<Bone> bones(g.joints);
  std::vector<V3> joints(g.joints), points(g.points), normals(g.points, V3{0, 0, 0});
  chain(g, betas, axis_angles, translation, bones, joints);

  std::vector<bool> used(g.groups, false);
  for (int layer = 0; layer < kLayers; ++layer)
    if (worn(person, layer)) used[g.layer_group[layer]] = true;
  for (int group = 0; group < g.groups; ++group) {
    if (!used[group]) continue;
    for (int64_t i = g.group_point[group]; i < g.group_point[group + 1]; ++i) {
      const float* p = dressed.rest + 3 * i;
      float m[12] = {};
      for (int32_t e = g.bone_begin[i]; e < g.bone_begin[i + 1]; ++e) {
        const float w = g.weights[e], *b = bones[g.bones[e]].m;
        for (int k = 0; k < 12; ++k) m[k] += w * b[k];
      }
      points[i] = {m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3], m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7],
                   m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11]};
    }
    add_normals(g.group_corners, g.group_triangle[group], g.group_triangle[group + 1], points.data(), normals.data());
    for (int64_t i = g.group_point[group]; i < g.group_point[group + 1]; ++i) normals[i] = unit(normals[i]);
  }

  std::vector<Capsule> capsules(g.capsules);
  for (int c = 0; c < g.capsules; ++c) {
    const float* s = g.capsule_shape + 4 * c;
    const Bone &a = bones[g.capsule_joints[2 * c]];
    const V3 across = {a.m[0] * s[1], a.m[4] * s[1], a.m[8] * s[1]};  // the bone's own left
    capsules[c] = {joints[g.capsule_joints[2 * c]] + across, joints[g.capsule_joints[2 * c + 1]] + across, s[0]};
    const V3 along = capsules[c].b - capsules[c].a;
    capsules[c].b = capsules[c].a + along * s[3];
    capsules[c].a = capsules[c].a + along * s[2];
  }
  std::vector<float> bend(g.joints);
  for (int j = 0; j < g.joints; ++j) bend[j] = least(1.2f, length(v3(axis_angles + 3 * j)) / 1.2f);

  V3* vertices = reinterpret_cast<V3*>(out.vertices);
  V3* across = reinterpret_cast<V3*>(out.normals);
  Receivers receivers;
  for (int layer = 0; layer < kLayers; ++layer) {
    if (layer == kEyes || !worn(person, layer)) continue;
    const int group = g.layer_group[layer];
    const int64_t point = g.group_point[group], count = g.group_point[group + 1] - point, first = g.layer_vertex[layer];
    const bool garment = layer >= kTrousers && layer <= kSkirt;
    for (int64_t i = 0; i < count; ++i) {
      const float* a = g.attributes + kAttributes * (point + i);
      float crease = 0;
      if (garment) {
        for (int c = 0; c < g.creases; ++c) {
          const float* at = g.crease_place + 4 * c;
          const float dx = (a[kX] - at[0]), dy = (a[kY] - at[1]), dz = (a[kZ] - at[2]);
          const float near = (dx * dx + dy * dy + dz * dz) / (at[3] * at[3]);
          if (near < 4) crease = most(crease, bend[g.crease_joint[c]] * (1 - near / 4) * (1 - near / 4));
        }
      }
      out.crease[first + i] = crease;
      vertices[first + i] = points[point + i] + normals[point + i] * (dressed.push[first + i] + (garment ? 0.004f * crease : 0.0f));
    }
    if (layer == kBody) {
      std::memcpy(across + first, &normals[point], count * sizeof(V3));
    } else {
      std::memset(across + first, 0, count * sizeof(V3));
      // The layer's triangles are its group's, in the same order of points.
      add_normals(g.corners, g.layer_triangle[layer], g.layer_triangle[layer + 1], vertices, across);
      for (int64_t i = 0; i < count; ++i) across[first + i] = unit(across[first + i]);
    }
    // What lies well under other layers is never drawn.
    for (int64_t i = first; i < first + count; ++i)
      if (dressed.kept[i] > -0.05f) receivers.add((int32_t)i, vertices[i], across[i]);
    for (int64_t i = 0; i < count; ++i) out.sky[first + i] = g.attributes[kAttributes * (point + i) + kSky];
  }
  receivers.pad();
  for (const Capsule& c : capsules) shade(c, v3(light.direction), receivers);
  for (size_t i = 0; i < receivers.vertex.size(); ++i) {
    out.sky[receivers.vertex[i]] *= receivers.sky[i];
    out.shadow[receivers.vertex[i]] = receivers.shadow[i];
  }
}

}  // namespace soar::people
