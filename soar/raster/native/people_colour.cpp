// Colours as functions of the rest position: cloth with its patterns and trimmings, skin, hair; and the light on them.
// All colours are linear; soar/synthetic draws the numbers.
#include "people.h"

namespace soar::people {
namespace {

constexpr float kPi = 3.14159265f;

// How much of a detail of this size, metres, a sample of this footprint can still show.
float visible(float size, float footprint) { return ramp(0.7f, 2.0f, size / footprint); }

// A line of a width about distance zero, softened to the footprint.
float line(float distance, float width, float footprint) {
  const float soft = most(0.5f * footprint, 1e-4f);
  return clamp01((0.5f * width + soft - std::fabs(distance)) / (2 * soft)) * clamp01(width / footprint + 0.25f);
}

float above(float x, float footprint) { return clamp01(0.5f + x / most(footprint, 1e-4f)); }

// A square wave of unit period in t: 1 on `duty` of it, softened by `soft` periods.
float bars(float t, float duty, float soft) {
  const float x = std::fabs(t - std::floor(t) - 0.5f);  // 0.5 at the start of a bar
  const float wave = clamp01(0.5f + (x - 0.5f * (1 - duty)) / most(soft, 1e-3f));
  return mix(wave, duty, ramp(0.4f, 1.2f, soft));
}

struct Chart {  // where a sample lies on its garment, metres
  float u, v;   // around and along the trunk or limb
  bool arm, back;
  float side;   // distance behind the side seam
};

Chart chart(const Anchors& k, int layer, const float* a) {
  Chart c;
  const float ax = std::fabs(a[kX]);
  c.arm = a[kArm] > 0.045f && (layer == kTop || layer == kJacket);
  const bool leg = layer == kTrousers && a[kZ] < k.crotch;
  float cx = 0, cy = -0.03f, radius = 0.16f;
  if (leg) {
    const float down = clamp01((k.crotch - a[kZ]) / (k.crotch - k.ankle));
    cx = mix(k.hip_x, k.ankle_x, down), cy = -0.02f, radius = mix(0.085f, 0.05f, down);
  }
  if (layer >= kHair) cy = k.ear_y + 0.015f, radius = 0.09f;
  if (c.arm) {
    const V3 along = v3(k.arm), r = {ax - 0.185f, a[kY] + 0.03f, a[kZ] - k.shoulder};
    const V3 across = r - along * dot(r, along);
    c.u = 0.05f * std::atan2(across.y, dot(across, V3{along.z, 0, -along.x})), c.v = -a[kArm];
    c.back = false, c.side = 1;
    return c;
  }
  const float y = a[kY] - cy;
  c.u = radius * std::atan2(leg ? ax - cx : a[kX], -y), c.v = a[kZ];
  if (leg && a[kX] < 0) c.u = -c.u;
  c.back = y > 0, c.side = y;
  return c;
}

enum { kPlain, kHoops, kPinstripes, kChecks, kTwoTone, kBlotches, kRaglan, kMarl, kDots, kDiagonal, kZigzag, kArgyle, kFade, kHalves, kTiles };

V3 patterned(const Pattern& p, const Chart& c, const float* a, V3 seed, float footprint) {
  const V3 first = v3(p.first), second = v3(p.second), third = v3(p.third);
  const float soft = footprint / p.period, u = c.u / p.period, v = c.v / p.period;
  float t = 0, t3 = 0;
  switch ((int)p.kind) {
    case kHoops: t = bars(v, p.duty, soft); break;
    case kPinstripes: t = bars(u, p.duty, soft); break;
    case kChecks: {
      const float x = bars(u, p.duty, soft), y = bars(v, p.duty, soft);
      t = 0.5f * (x + y), t3 = 0.8f * bars(u + 0.5f, 0.12f, soft) + 0.8f * bars(v + 0.5f, 0.12f, soft);
      break;
    }
    case kTwoTone: t = above(p.level - (c.arm ? -1.0f : a[kZ]), footprint); break;
    case kBlotches: {
      const V3 q = (V3{a[kX], a[kY], a[kZ]} + seed) * (1 / p.period);
      const float n = noise(q) + 0.4f * noise(q * 2.3f);
      t = ramp(0.05f, 0.12f, n), t3 = ramp(0.35f, 0.42f, noise(q * 1.2f + V3{7, 3, 1}));
      break;
    }
    case kRaglan: t = c.arm ? 1.0f : above(0.35f * std::fabs(a[kX]) + a[kZ] - p.level, footprint); break;
    case kMarl: t = 0.5f + 0.5f * noise(V3{c.u, c.v, seed.x} * (900.0f)) * visible(0.004f, footprint); break;
    case kDots: {
      const float row = std::floor(v), x = u + 0.5f * (row - 2 * std::floor(row / 2)) - std::floor(u + 0.5f * (row - 2 * std::floor(row / 2))) - 0.5f;
      const float y = v - row - 0.5f;
      t = mix(clamp01(0.5f + (0.5f * p.duty - std::sqrt(x * x + y * y)) / most(soft, 1e-3f)), 0.785f * p.duty * p.duty, ramp(0.4f, 1.2f, soft));
      break;
    }
    case kDiagonal: t = bars(0.7071f * (u + v), p.duty, soft); break;
    case kZigzag: t = bars(v + 0.6f * std::fabs(2 * (u - std::floor(u)) - 1), p.duty, soft); break;
    case kArgyle: {
      t = bars(u + 0.6f * v, 0.5f, soft), t = t * bars(u - 0.6f * v, 0.5f, soft) + (1 - t) * (1 - bars(u - 0.6f * v, 0.5f, soft));
      t3 = most(bars(u + 0.6f * v + 0.25f, 0.05f, soft), bars(u - 0.6f * v + 0.25f, 0.05f, soft));
      break;
    }
    case kFade: t = c.arm ? ramp(0.0f, -0.5f, c.v) : ramp(p.level + 0.25f, p.level - 0.25f, a[kZ]); break;
    case kHalves: t = above(a[kX], footprint); break;
    case kTiles: {
      const float x = bars(u, 0.5f, soft), y = bars(v, 0.5f, soft);
      t = x * (1 - y) + y * (1 - x);
      break;
    }
    default: break;
  }
  return mix(mix(first, second, clamp01(t) * p.shade), third, clamp01(t3) * p.shade);
}

float capsule(float x, float y, float ax, float ay, float bx, float by) {
  const float dx = bx - ax, dy = by - ay, t = clamp01(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy + 1e-9f));
  return std::hypot(x - ax - t * dx, y - ay - t * dy);
}

float digit(int n, float x, float y) {  // distance to the strokes of a seven-segment digit of height 2, width 1.1
  static const uint8_t strokes[10] = {0x77, 0x24, 0x5d, 0x6d, 0x2e, 0x6b, 0x7b, 0x25, 0x7f, 0x6f};
  const float s[7][4] = {{-.5f, 1, .5f, 1},  {-.5f, 1, -.5f, 0},  {.5f, 1, .5f, 0},  {-.5f, 0, .5f, 0},
                         {-.5f, 0, -.5f, -1}, {.5f, 0, .5f, -1}, {-.5f, -1, .5f, -1}};
  float d = 9;
  for (int k = 0; k < 7; ++k)
    if (strokes[n] >> k & 1) d = least(d, capsule(x, y, s[k][0], s[k][1], s[k][2], s[k][3]));
  return d - 0.2f;
}

float polygon(int sides, float sharp, float x, float y) {  // star or regular polygon of unit radius
  const float angle = std::atan2(x, y), sector = 2 * kPi / sides;
  const float t = angle - sector * std::floor(angle / sector + 0.5f);
  return std::hypot(x, y) * mix(std::cos(t) / std::cos(sector / 2), 1 + sharp * std::fabs(t) / sector * 2, sharp > 0) - 1;
}

enum { kNothing, kNumber, kDisc, kStar, kRing, kSquare, kBand, kBadge, kHeart, kTriangle, kCross, kBolt, kSun, kFrame };

// Signed distance, in print sizes, negative inside; x to the wearer's left, y up, about the print's middle.
float print_shape(const Print& p, float x, float y) {
  switch ((int)p.kind) {
    case kNumber: {
      const int n = (int)p.index;
      if (n < 10) return digit(n, x * 1.1f, y * 1.1f);
      const float tens = digit(n / 10, x * 1.25f + 0.82f, y * 1.1f), ones = digit(n % 10, x * 1.25f - 0.82f, y * 1.1f);
      return least(tens, ones);
    }
    case kDisc: return std::hypot(x, y) - 0.9f;
    case kStar: return polygon(5, 1.3f, x, y);
    case kRing: return std::fabs(std::hypot(x, y) - 0.75f) - 0.2f;
    case kSquare: return most(std::fabs(x), std::fabs(y)) - 0.8f;
    case kBand: return most(std::fabs(y) - 0.25f, std::fabs(x) - 1.4f);
    case kBadge: return std::hypot(x - 1.1f, y - 0.6f) - 0.35f;
    case kHeart: {
      const float ax = std::fabs(x), q = y + 0.2f - 0.75f * ax + 0.35f * ax * ax;
      return std::hypot(ax, q * 1.05f) - 0.85f;
    }
    case kTriangle: return polygon(3, 0, x, y);
    case kCross: return least(most(std::fabs(x) - 0.25f, std::fabs(y) - 0.9f), most(std::fabs(y) - 0.25f, std::fabs(x) - 0.9f));
    case kBolt: return least(capsule(x, y, 0.3f, 0.9f, -0.3f, 0.05f), least(capsule(x, y, -0.3f, 0.05f, 0.3f, 0), capsule(x, y, 0.3f, 0, -0.2f, -0.9f))) - 0.17f;
    case kSun: return least(std::hypot(x, y) - 0.5f, polygon(9, 0.8f, x, y));
    case kFrame: return std::fabs(most(std::fabs(x), std::fabs(y) * 1.3f) - 0.8f) - 0.15f;
    default: return 1;
  }
}

void print(const Print& p, const float* a, bool back, float footprint, V3* colour) {
  if (p.kind < 1) return;
  const float x = (back ? -a[kX] : a[kX]) / p.size, y = (a[kZ] - p.height) / p.size;
  if (std::fabs(x) > 2.2f || std::fabs(y) > 1.6f) return;
  *colour = mix(*colour, v3(p.colour), above(-print_shape(p, x, y) * p.size, footprint));
}

// Seams, pockets, belt, buttons, trimmings. Depth of a groove is returned as a darkening.
float trimmings(const Anchors& k, const Cloth& c, int layer, const Chart& at, const float* a, float kept, float footprint, V3* colour) {
  float dark = 0;
  const float ax = std::fabs(a[kX]), z = a[kZ];
  const bool upper = layer == kTop || layer == kJacket;
  if (c.rim_width > 0 && kept < c.rim_width + footprint) {
    // Ribbed hems, cuffs and collars; they end in a stitched line.
    if (c.rim > 0) *colour = mix(*colour, v3(c.trim), c.rim * above(c.rim_width - kept, footprint));
    dark = most(dark, 0.35f * line(kept - c.rim_width, 0.004f, footprint));
    dark = most(dark, 0.30f * line(kept, 0.006f, footprint));
  }
  if (c.collar > 0 && !at.arm && z > k.shoulder - 0.05f && kept < c.collar) {
    *colour = mix(*colour, v3(c.trim), 0.6f * above(c.collar - kept, footprint));
    dark = most(dark, 0.5f * line(kept - c.collar, 0.005f, footprint));
  }
  if (c.seams > 0) {
    float seam = at.arm ? 1 : std::fabs(at.side);
    if (upper) seam = least(seam, std::fabs(a[kArm] - 0.045f));
    if (layer == kTrousers && z > k.crotch - 0.02f && z < c.high - 0.04f && a[kY] < -0.03f) seam = least(seam, ax);
    dark = most(dark, c.seams * line(seam, 0.004f, footprint));
  }
  if (layer == kTrousers && c.pockets > 0) {
    if (!at.back) {
      const float curve = std::hypot(ax - 0.17f, z - (c.high - 0.03f)) - 0.085f;
      if (z < c.high - 0.035f) dark = most(dark, 0.5f * line(curve, 0.005f, footprint));
    } else {
      const float box = most(std::fabs(ax - 0.085f) - 0.055f, std::fabs(z - (c.high - 0.15f)) - 0.06f);
      dark = most(dark, 0.5f * line(box, 0.005f, footprint));
    }
  }
  if (upper && c.pockets > 0 && !at.back && !at.arm) {
    const float box = most(std::fabs(a[kX] - 0.075f) - 0.045f, std::fabs(z - (k.chest + 0.01f)) - 0.05f);
    dark = most(dark, 0.45f * line(box, 0.005f, footprint));
  }
  if (c.belt > 0 && kept < c.belt && z > k.crotch + 0.05f) {
    *colour = mix(*colour, v3(c.trim), above(c.belt - kept, footprint));
    if (!at.back && ax < 0.028f) *colour = mix(*colour, v3(c.metal), line(most(ax - 0.017f, std::fabs(kept - 0.5f * c.belt) - 0.013f), 0.010f, footprint));
  }
  if (c.buttons > 0 && !at.back && !at.arm) {
    const float row = (z - k.chest) / 0.085f, to = 0.085f * (row - std::floor(row + 0.5f));
    if (c.buttons > 1.5f) {  // a zip
      *colour = mix(*colour, v3(c.metal), line(ax, 0.012f, footprint));
    } else {
      dark = most(dark, 0.35f * line(ax - 0.017f, 0.004f, footprint));
      *colour = mix(*colour, v3(c.metal), line(std::hypot(ax, to), 0.014f, footprint));
    }
  }
  if (layer == kShoes) {
    if (c.sole > 0) *colour = mix(*colour, v3(c.trim), above(k.ground + c.sole - z, footprint));
    const float front = ramp(-0.045f, -0.06f, a[kY]) * ramp(-0.15f, -0.135f, a[kY]);
    if (c.laces > 0 && z > k.ground + 0.045f && std::fabs(ax - k.ankle_x + 0.01f) < 0.035f)
      *colour = mix(*colour, v3(c.metal), front * bars(a[kY] / 0.017f, 0.45f, footprint / 0.017f));
  }
  return dark;
}

Surface dressed(const Anchors& k, const Person& person, int layer, const float* a, float kept, float crease, float footprint) {
  const Cloth& c = cloth(person, layer);
  const Chart at = chart(k, layer, a);
  const V3 seed = v3(c.seed), r = {a[kX], a[kY], a[kZ]};
  const float behind = layer == kShoes || at.arm ? 0 : above(at.side, footprint);
  V3 colour = patterned(behind > 0.5f ? c.back : c.front, at, a, seed, footprint);
  if (!at.arm) print(behind > 0.5f ? c.spine : c.chest, a, behind > 0.5f, footprint, &colour);
  const float dark = trimmings(k, c, layer, at, a, kept, footprint, &colour);
  const float weave = c.grain * visible(0.006f, footprint) * noise((r + seed) * 350.0f);
  const float worn = 0.06f * noise((r + seed) * 14.0f);
  Surface s{colour * (1 + weave + worn) * (1 - dark), c.gloss, {0, 0, 0}};
  if (layer > kSkirt) return s;

  // Folds: long across the pull of the cloth, short along the limb, stronger where a joint is bent and near the waist.
  const V3 along = a[kArm] > 0.03f ? V3{std::copysign(k.arm[0], a[kX]), k.arm[1], k.arm[2]} : V3{0, 0, 1};
  const bool skirt = layer == kSkirt;
  const float wide = skirt ? 26.0f : 13.0f, tight = skirt ? 5.0f : 30.0f;  // a skirt's folds run downwards
  V3 slope{0, 0, 0};
  for (int octave = 0; octave < 2; ++octave) {
    const float scale = octave ? 2.1f : 1.0f, size = 0.6f / (most(wide, tight) * scale);
    const float shown = visible(size, footprint);
    if (!(shown > 0)) break;
    V3 g;
    const V3 q = ((r + seed) * wide + along * (dot(r, along) * (tight - wide))) * scale;
    noise(q, &g);
    g = (g * wide + along * (dot(g, along) * (tight - wide))) * scale;
    slope = slope + g * ((octave ? 0.35f : 1.0f) * shown);
  }
  const float waist = layer == kSkirt || at.arm ? 0 : ramp(0.12f, 0.0f, std::fabs(a[kZ] - k.waist));
  s.slope = slope * (c.crease * (0.18f + 0.8f * crease + 0.3f * waist));
  return s;
}

V3 eye(const Anchors& k, const Person& p, const float* a, float footprint) {
  const V3 d = {std::fabs(a[kX]) - k.eye[0], a[kY] - k.eye[1], a[kZ] - k.eye[2]};
  const V3 n = unit(d);
  const float off = 0.0125f * std::acos(clamp01(-n.y));  // metres along the ball from its pole
  V3 colour = {0.62f, 0.60f, 0.57f};
  colour = mix(colour, v3(p.iris), above(0.0062f - off, footprint));
  colour = mix(colour, V3{0.008f, 0.008f, 0.008f}, above(0.0027f - off, footprint));
  const float lid = ramp(0.004f, 0.009f, d.z);  // shadow of the upper lid
  return colour * (1 - 0.6f * lid);
}

float polyline(const float (*points)[2], int count, float x, float y, float* t = nullptr) {
  float best = 9;
  for (int i = 0; i + 1 < count; ++i) {
    const float d = capsule(x, y, points[i][0], points[i][1], points[i + 1][0], points[i + 1][1]);
    if (d < best) {
      best = d;
      if (t) *t = (i + 0.5f) / (count - 1);
    }
  }
  return best;
}

Surface skin(const Anchors& k, const Person& p, const float* a, float footprint) {
  const V3 r = {a[kX], a[kY], a[kZ]};
  const float ax = std::fabs(a[kX]);
  V3 colour = v3(p.skin);
  colour = colour * (1 + 0.07f * noise(r * 22) + 0.05f * noise(r * 90) * visible(0.011f, footprint));
  const V3 flushed = colour * V3{1.12f, 0.80f, 0.78f};
  float red = 0;
  if (a[kHead] > 0.4f) {
    const float front = ramp(k.ear_y - 0.01f, k.ear_y - 0.04f, a[kY]);
    const float cheek = std::hypot(ax - 0.042f, a[kZ] - (k.nose[2] - 0.008f));
    red = front * (1.2f * ramp(0.032f, 0.005f, cheek) + ramp(0.016f, 0.004f, std::hypot(ax, a[kZ] - k.nose[2] + 0.004f)));
    red += 0.7f * ramp(0.02f, 0.0f, std::fabs(ax - k.ear_x - 0.006f)) * ramp(0.04f, 0.02f, std::fabs(a[kZ] - k.ear_z));
  }
  red += 0.6f * a[kHand] + 0.35f * a[kFoot];
  colour = mix(colour, flushed, clamp01(p.flush * red));
  if (p.freckles > 0 && a[kHead] > 0.3f) colour = colour * (1 - p.freckles * ramp(0.45f, 0.7f, noise(r * 320)) * visible(0.004f, footprint));
  float gloss = 0.10f;
  if (a[kHead] > 0.4f && a[kY] < k.ear_y - 0.015f) {  // the face
    const float x = ax, z = a[kZ];
    const V3 hair = v3(p.brows);
    // Beard: jaw and upper lip, not the lips.
    const float jaw = ramp(k.nose[2] - 0.012f, k.nose[2] - 0.03f, z + 0.25f * most(0.0f, x - 0.02f) - 0.02f * ramp(0.05f, 0.068f, x));
    if (p.beard > 0) colour = mix(colour, hair, p.beard * jaw * (0.8f + 0.2f * noise(r * 200)));
    // Lips between two curves that meet in the corners.
    const float u = x / k.lip_width;
    if (u < 1.15f) {
      const float bow = 1 - u * u, top = k.lip[2] + k.lip_upper * bow * (1 - 0.18f * ramp(0.25f, 0.0f, u)), low = k.lip[2] - k.lip_lower * bow;
      const float inside = least(least(top - z, z - low), 0.5f * (k.lip_width - x));
      colour = mix(colour, v3(p.lips), above(inside, 1.2f * footprint + 0.001f));
      colour = colour * (1 - 0.6f * line(z - k.lip[2] + 0.001f * bow, 0.0022f, footprint) * ramp(1.05f, 0.9f, u));
    }
    // Brows: a tapering stroke.
    float t = 0.5f;
    const float brow = polyline(k.brow, 5, x, z - 0.004f, &t);
    const float thick = 0.0052f * (0.55f + 0.45f * std::sin(kPi * (0.15f + 0.75f * t)));
    colour = mix(colour, hair, 0.85f * above(thick - brow, footprint + 0.002f));
    // Lids: lashes above, a soft line below, shade in the sockets.
    const float upper = polyline(k.lid_upper, 6, x, z), lower = polyline(k.lid_lower, 6, x, z);
    colour = mix(colour, hair * 0.4f, 0.9f * line(upper, 0.0042f, footprint));
    colour = mix(colour, hair * 0.7f + colour * 0.2f, 0.5f * line(lower, 0.0025f, footprint));
    colour = colour * (1 - 0.22f * ramp(0.014f, 0.002f, upper));
    // Nose: nostrils and the shade under its tip.
    const float nostril = std::hypot((x - 0.0075f) / 0.0052f, (z - k.nose[2]) / 0.0032f);
    colour = colour * (1 - 0.65f * clamp01(1.6f - nostril));
    colour = colour * (1 - 0.15f * line(x - 0.0155f, 0.004f, footprint) * ramp(0.014f, 0.004f, std::fabs(z - k.nose[2] - 0.006f)));
    gloss = 0.16f;
  }
  if (p.sock_top > k.ground && a[kZ] < p.sock_top && a[kFoot] + (a[kZ] < k.knee) > 0.5f)
    colour = v3(p.sock) * (1 + 0.06f * noise(r * 200) * visible(0.006f, footprint)), gloss = 0.03f;
  return {colour, gloss, {0, 0, 0}};
}

Surface hair(const Anchors& k, const Person& p, int layer, const float* a, float footprint) {
  const Cloth& c = cloth(p, layer);
  const Chart at = chart(k, layer, a);
  const V3 seed = v3(c.seed), r = {a[kX], a[kY], a[kZ]};
  // Strands run from the crown down: fine across the azimuth, long along the height.
  const V3 q = {a[kX] * 330, a[kY] * 330, a[kZ] * 20};
  const float strand = noise(q + seed) * visible(0.005f, footprint) + 0.5f * noise(V3{a[kX] * 70, a[kY] * 70, a[kZ] * 8} + seed);
  const float curl = p.strands * noise((r + seed) * 160.0f) * visible(0.006f, footprint);
  const V3 base = mix(v3(c.front.first), v3(c.front.second), clamp01(0.5f + 0.5f * noise(V3{at.u * 40, a[kZ] * 5, seed.z})) * c.front.shade);
  Surface s{base * most(0.25f, 1 + 0.42f * strand + 0.4f * curl), c.gloss, {0, 0, 0}};
  if (visible(0.01f, footprint) > 0) {
    V3 g;
    noise(V3{a[kX] * 150, a[kY] * 150, a[kZ] * 18} + seed, &g);
    s.slope = V3{g.x * 150, g.y * 150, g.z * 18} * (0.0016f * visible(0.01f, footprint));
  }
  return s;
}

}  // namespace

Surface surface(const Anchors& k, const Person& p, int layer, const float* a, float kept, float crease, float footprint) {
  switch (layer) {
    case kBody: return skin(k, p, a, footprint);
    case kEyes: return {eye(k, p, a, footprint), 0.5f, {0, 0, 0}};
    case kHair:
    case kLongHair: return hair(k, p, layer, a, footprint);
    default: return dressed(k, p, layer, a, kept, crease, footprint);
  }
}

V3 lit(const Light& light, const Surface& s, V3 n, V3 towards_eye, float sky, float shadow) {
  const float basis[9] = {1, n.y, n.z, n.x, n.x * n.y, n.y * n.z, 3 * n.z * n.z - 1, n.x * n.z, n.x * n.x - n.y * n.y};
  V3 ambient{0, 0, 0};
  for (int i = 0; i < 9; ++i) ambient = ambient + v3(light.sky[i]) * basis[i];
  ambient = {most(0.0f, ambient.x), most(0.0f, ambient.y), most(0.0f, ambient.z)};
  const V3 towards = v3(light.direction);
  const float cosine = most(0.0f, (dot(n, towards) + light.wrap) / (1 + light.wrap)) * shadow;
  const V3 received = ambient * sky + v3(light.colour) * cosine;
  const float half = most(0.0f, dot(n, unit(towards + towards_eye)));
  const float h4 = half * half * half * half, shine = s.gloss * h4 * h4 * h4 * h4 * shadow * 0.6f;
  return (s.albedo * received + v3(light.colour) * shine) * light.exposure;
}

}  // namespace soar::people
