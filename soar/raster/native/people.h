// Clothed people as training data: one static triangle list of layers (skin, eyes, garments, hair), posed, pushed out
// along its normals, cut per sample, and coloured as a function of the rest position. soar/synthetic fills the records.
//
// A layer's vertices are copies of a group of points; a point is skinned once for all layers that use it. Rest
// positions are those of the mean shape, so a cut or a pattern sits alike on every shape.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "simd.h"
#include "team.h"

namespace soar::people {

enum Layer : int { kBody, kEyes, kTrousers, kTop, kJacket, kSkirt, kShoes, kHair, kLongHair, kCap, kBrim, kLayers };
constexpr int kFirstCloth = kTrousers, kCloths = kLayers - kFirstCloth;

// What is known of a point of the mean shape: position, metres along the arm (0 shoulder; zero elsewhere), skin weights
// of hands, head and feet, and the share of the sky it sees in an open pose.
enum Attribute { kX, kY, kZ, kArm, kHand, kHead, kFoot, kSky, kAttributes };

struct V3 {
  float x, y, z;
};
SOAR_INLINE V3 operator+(V3 a, V3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
SOAR_INLINE V3 operator-(V3 a, V3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
SOAR_INLINE V3 operator*(V3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
SOAR_INLINE V3 operator*(V3 a, V3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
SOAR_INLINE float dot(V3 a, V3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
SOAR_INLINE V3 cross(V3 a, V3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
SOAR_INLINE float length(V3 a) { return std::sqrt(dot(a, a)); }
SOAR_INLINE V3 unit(V3 a) { return a * (1.0f / std::fmax(length(a), 1e-20f)); }
SOAR_INLINE V3 mix(V3 a, V3 b, float t) { return a + (b - a) * t; }
SOAR_INLINE float mix(float a, float b, float t) { return a + (b - a) * t; }
SOAR_INLINE float least(float a, float b) { return a < b ? a : b; }
SOAR_INLINE float most(float a, float b) { return a > b ? a : b; }
SOAR_INLINE float clamp01(float t) { return least(most(t, 0.0f), 1.0f); }
SOAR_INLINE float ramp(float a, float b, float x) {  // smooth step from 0 at a to 1 at b
  const float t = clamp01((x - a) / (b - a));
  return t * t * (3 - 2 * t);
}
SOAR_INLINE V3 v3(const float* p) { return {p[0], p[1], p[2]}; }

// The records below are arrays of floats in this order; soar/synthetic/records.py mirrors them field by field, and the
// library tells their sizes so that the two cannot drift apart unseen.

struct Anchors {  // heights and places on the mean shape, metres; the left half stands for both
  float ground, ankle, knee, crotch, waist, chest, shoulder, neck, chin, crown;
  float hip_x, ankle_x, neck_y, ear_x, ear_y, ear_z;
  float eye[3], brow[5][2], lid_upper[6][2], lid_lower[6][2];  // polylines in (|x|, z)
  float lip[3], lip_width, lip_upper, lip_lower, nose[3];
  float arm[3];                                                // unit, along the left arm
};

struct Pattern {
  float kind, period, duty, level, shade;  // shade: how far the second colour is mixed in
  float first[3], second[3], third[3];
};

struct Print {
  float kind, size, height, index, colour[3];
};

struct Cloth {
  float worn, thickness, flare, flare_range, bumps, bump_length;             // shape
  float low, high, sleeve, neck, neck_slope, vee, strap, opening, spread;    // cut
  float crease, gloss, grain, rim, rim_width, collar, seams, pockets, buttons, belt, sole, laces;
  Pattern front, back;
  Print chest, spine;
  float trim[3], metal[3], seed[3];
};

struct Person {
  float skin[3], lips[3], brows[3], iris[3], sock[3];
  float flush, freckles, beard, sock_top;
  float hairline, nape, ears, strands, fringe, hair_front;
  Cloth cloth[kCloths];
};

struct Light {
  float sky[9][3];  // radiance by real spherical harmonics up to order two, world axes, already convolved
  float direction[3], colour[3], wrap, exposure;
};

struct Geometry {
  int32_t points, joints, betas, vertices, triangles, groups, capsules, creases;
  const float *template_, *shapedirs;                   // (P, 3), (B, P, 3)
  const int32_t *bone_begin, *bones;                    // (P + 1), entries
  const float* weights;                                 // entries
  const float *joint_template, *joint_shapedirs;        // (J, 3), (J, 3, B)
  const int32_t* parents;                               // (J)
  const int32_t *group_point, *group_triangle;          // (G + 1): points and triangles of a group
  const int32_t* group_corners;                         // (., 3) points, all groups
  const int32_t *layer_group, *layer_vertex, *layer_triangle;  // (L), (L) first vertex, (L + 1) first triangle
  const int32_t* corners;                               // (T, 3) layer vertices
  const float* attributes;                              // (P, A)
  const int32_t* capsule_joints;                        // (C, 2)
  const float* capsule_shape;                           // (C, 4) radius and offset of both ends from the joints
  const int32_t* crease_joint;                          // (N): a bent joint folds the cloth about a place
  const float* crease_place;                            // (N, 4) place on the mean shape and reach
  const Anchors* anchors;
};

SOAR_INLINE const Cloth& cloth(const Person& p, int layer) { return p.cloth[layer - kFirstCloth]; }
SOAR_INLINE bool worn(const Person& p, int layer) { return layer < kFirstCloth || cloth(p, layer).worn > 0; }

// Value noise in [-1, 1] with its gradient; lattice values are hashed integers, so they are the same everywhere.
SOAR_INLINE float lattice(int32_t x, int32_t y, int32_t z) {
  uint32_t h = (uint32_t)x * 0x8da6b343u ^ (uint32_t)y * 0xd8163841u ^ (uint32_t)z * 0xcb1ab31fu;
  h ^= h >> 15, h *= 0x2c1b3c6du, h ^= h >> 12, h *= 0x297a2d39u, h ^= h >> 15;
  return (float)(h >> 8) * (2.0f / 16777215.0f) - 1.0f;
}
SOAR_INLINE float noise(V3 p, V3* gradient = nullptr) {
  const float fx = std::floor(p.x), fy = std::floor(p.y), fz = std::floor(p.z);
  const int32_t x = (int32_t)fx, y = (int32_t)fy, z = (int32_t)fz;
  const float tx = p.x - fx, ty = p.y - fy, tz = p.z - fz;
  const float ux = tx * tx * tx * (tx * (tx * 6 - 15) + 10), uy = ty * ty * ty * (ty * (ty * 6 - 15) + 10);
  const float uz = tz * tz * tz * (tz * (tz * 6 - 15) + 10);
  const float a = lattice(x, y, z), b = lattice(x + 1, y, z), c = lattice(x, y + 1, z), d = lattice(x + 1, y + 1, z);
  const float e = lattice(x, y, z + 1), f = lattice(x + 1, y, z + 1), g = lattice(x, y + 1, z + 1);
  const float h = lattice(x + 1, y + 1, z + 1);
  const float k1 = b - a, k2 = c - a, k3 = e - a, k4 = a - b - c + d, k5 = a - c - e + g, k6 = a - b - e + f;
  const float k7 = -a + b + c - d + e - f - g + h;
  if (gradient) {
    const float dx = 30 * tx * tx * (tx * (tx - 2) + 1), dy = 30 * ty * ty * (ty * (ty - 2) + 1);
    const float dz = 30 * tz * tz * (tz * (tz - 2) + 1);
    *gradient = {dx * (k1 + k4 * uy + k6 * uz + k7 * uy * uz), dy * (k2 + k4 * ux + k5 * uz + k7 * ux * uz),
                 dz * (k3 + k6 * ux + k5 * uy + k7 * ux * uy)};
  }
  return a + k1 * ux + k2 * uy + k3 * uz + k4 * ux * uy + k5 * uy * uz + k6 * uz * ux + k7 * ux * uy * uz;
}

// people_cut.cpp: signed distance-like field, metres, positive where a layer is kept; and a layer's push along its normal.
float keep(const Anchors& anchors, const Person& person, int layer, const float* a);
float push(const Anchors& anchors, const Person& person, int layer, const float* a, float kept);

// people_colour.cpp
struct Surface {
  V3 albedo;          // linear
  float gloss;        // strength of the highlight
  V3 slope;           // gradient of the fine relief by rest position, dimensionless
};
Surface surface(const Anchors& anchors, const Person& person, int layer, const float* a, float kept, float crease,
                float footprint);
V3 lit(const Light& light, const Surface& s, V3 normal, V3 towards_eye, float sky, float shadow);

}  // namespace soar::people
