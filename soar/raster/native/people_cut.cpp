// Where each layer ends, and how far it stands off the skin.
#include "people.h"

namespace soar::people {
namespace {

float cut_trousers(const Cloth& c, const float* a) {
  const float waistband = c.high - 0.1f * (a[kY] + 0.03f);  // lower at the back, as it hangs
  return least(least(waistband - a[kZ], a[kZ] - c.low), 0.12f - 2 * a[kArm]);
}

float neckline(const Anchors& k, const Cloth& c, const float* a) {
  const float ax = std::fabs(a[kX]), front = ramp(k.neck_y + 0.01f, k.neck_y - 0.05f, a[kY]);
  // The hole is round the neck: its rim climbs towards the shoulders.
  const float base = c.neck + c.neck_slope * (a[kY] - k.neck_y) + 0.75f * (std::sqrt(ax * ax + 0.0036f) - 0.06f);
  return base - front * most(0.0f, c.vee * (1 - ax / 0.075f)) - a[kZ];
}

float cut_top(const Anchors& k, const Cloth& c, const float* a) {
  const float above_hem = most(a[kZ] - c.low, 4 * (a[kArm] - 0.03f));  // hands may hang below the hem
  float s = least(least(above_hem, neckline(k, c, a)), c.sleeve - a[kArm]);
  if (c.strap > 0) s = least(s, c.strap + 1.2f * most(0.0f, k.chest + 0.02f - a[kZ]) - std::fabs(a[kX]));
  if (c.opening > 0) {
    const float gap = c.opening + c.spread * most(0.0f, k.neck - 0.06f - a[kZ]);
    s = least(s, most(std::fabs(a[kX]) - gap, a[kY] - (k.neck_y - 0.02f)));
  }
  return s;
}

float cut_shoes(const Cloth& c, const float* a) { return c.high - a[kZ] - 0.25f * most(0.0f, a[kY]); }

// Height of the hairline over the profile of the head, from forehead to nape.
float hairline(const Anchors& k, const Person& p, const float* a) {
  const float head = k.crown - k.chin, face = k.eye[1] - 0.03f;
  const float knots[7][2] = {
      {face, k.crown - 0.21f * head + p.hairline}, {face + 0.05f, k.crown - 0.25f * head + p.hairline},
      {k.ear_y - 0.040f, k.crown - 0.36f * head + 0.5f * p.hairline}, {k.ear_y - 0.020f, k.ear_z + 0.012f - p.ears},
      {k.ear_y + 0.012f, k.ear_z - 0.005f - p.ears}, {k.ear_y + 0.032f, k.ear_z - 0.055f - 0.5f * p.nape},
      {k.ear_y + 0.075f, k.chin + 0.012f - p.nape},
  };
  if (a[kY] <= knots[0][0]) return knots[0][1];
  for (int i = 1; i < 7; ++i)
    if (a[kY] < knots[i][0]) return mix(knots[i - 1][1], knots[i][1], (a[kY] - knots[i - 1][0]) / (knots[i][0] - knots[i - 1][0]));
  return knots[6][1];
}

float cut_hair(const Anchors& k, const Person& p, const float* a) {
  float s = 0.7f * (a[kZ] - hairline(k, p, a));
  const float temple = std::fabs(a[kX]) / k.ear_x;
  s -= 0.010f * ramp(0.55f, 0.85f, temple) * ramp(k.ear_y - 0.02f, k.ear_y - 0.05f, a[kY]);
  const V3 q = {a[kX] * 130, a[kY] * 130, a[kZ] * 60};
  s += 0.005f * p.strands * noise(q);
  if (p.ears <= 0) {  // short hair leaves the ears free
    const float dy = (a[kY] - k.ear_y - 0.006f) / 0.019f, dz = (a[kZ] - k.ear_z + 0.003f) / 0.033f;
    if (std::fabs(a[kX]) > 0.8f * k.ear_x) s = least(s, 0.02f * (std::sqrt(dy * dy + dz * dz) - 1));
  }
  return s;
}

float cut_long_hair(const Anchors& k, const Person& p, const Cloth& c, const float* a) {
  const float ragged = 0.02f * noise({a[kX] * 60, a[kY] * 60, a[kZ] * 4});
  float s = a[kZ] - c.low + ragged;
  const float face = most(std::fabs(a[kX]) - (p.hair_front + 0.35f * most(0.0f, k.eye[2] - a[kZ])), a[kY] - (k.ear_y - 0.015f));
  const float fringe = a[kZ] - (k.crown - p.fringe) + ragged;
  return least(s, most(face, fringe));
}

float cut_cap(const Anchors& k, const Cloth& c, const float* a) {
  return a[kZ] - (c.low + 0.35f * (k.ear_y - 0.03f - a[kY]) * (a[kY] < k.ear_y ? 0.6f : 1.0f));
}

float cut(const Anchors& k, const Person& p, int layer, const float* a) {
  const Cloth& c = cloth(p, layer);
  switch (layer) {
    case kTrousers: return cut_trousers(c, a);
    case kTop:
    case kJacket: return cut_top(k, c, a);
    case kSkirt: return least(c.high - a[kZ], a[kZ] - c.low);
    case kShoes: return cut_shoes(c, a);
    case kHair: return cut_hair(k, p, a);
    case kLongHair: return cut_long_hair(k, p, c, a);
    default: return cut_cap(k, c, a);
  }
}

// How far inside its edge a layer hides what lies under it.
float hides(const Anchors& k, const Person& p, int above, const float* a, float margin) {
  return worn(p, above) ? margin - cut(k, p, above, a) : margin;
}

}  // namespace

float keep(const Anchors& k, const Person& p, int layer, const float* a) {
  switch (layer) {
    case kBody: {
      float s = 0.03f;
      for (int above : {kTrousers, kTop, kJacket}) s = least(s, hides(k, p, above, a, 0.03f));
      if (a[kHead] > 0.3f) {
        s = least(s, hides(k, p, kHair, a, 0.012f));
        s = least(s, hides(k, p, kCap, a, 0.012f));
      }
      if (a[kZ] < k.knee) s = least(s, hides(k, p, kShoes, a, 0.015f));
      return s;
    }
    case kEyes:
    case kBrim: return 1;
    case kTrousers: {
      float s = least(cut(k, p, layer, a), least(hides(k, p, kTop, a, 0.04f), hides(k, p, kJacket, a, 0.06f)));
      return least(s, hides(k, p, kShoes, a, cloth(p, kShoes).high > k.ankle + 0.04f ? 0.03f : 1.0f));
    }
    case kSkirt: return least(cut(k, p, layer, a), hides(k, p, kJacket, a, 0.005f));
    case kTop: return least(cut(k, p, layer, a), hides(k, p, kJacket, a, 0.05f));
    case kHair: return least(cut(k, p, layer, a), hides(k, p, kCap, a, 0.012f));
    case kLongHair: {
      const float s = cut(k, p, layer, a);
      return worn(p, kCap) ? least(s, cloth(p, kCap).low + 0.03f - a[kZ]) : s;
    }
    default: return cut(k, p, layer, a);
  }
}

float push(const Anchors& k, const Person& p, int layer, const float* a, float kept) {
  if (layer < kFirstCloth || layer == kBrim) return 0;
  const Cloth& c = cloth(p, layer);
  const V3 seed = v3(c.seed), r = {a[kX], a[kY], a[kZ]};
  const float rough = c.bumps * noise((r + seed) * (1 / c.bump_length));
  switch (layer) {
    case kHair: {
      // Thin at the edge, thickest at the crown: no rim stands off the forehead.
      const float body = ramp(-0.002f, 0.025f, kept), top = 0.6f + 0.4f * ramp(k.eye[2], k.crown, a[kZ]);
      return 0.002f + body * (c.thickness * top + rough * 1.5f);
    }
    case kLongHair: {  // lies on what is worn about the neck
      const float collar = worn(p, kJacket) ? cloth(p, kJacket).thickness + 0.012f : 0.012f;
      return c.thickness + rough + collar * ramp(k.chin + 0.01f, k.shoulder, a[kZ]);
    }
    case kCap: {
      const float inside = ramp(0.0f, 0.03f, kept);
      return c.thickness + 0.006f * inside + rough;
    }
    case kShoes: {
      const float toe = ramp(-0.02f, -0.15f, a[kY]);
      return c.thickness * (1 - 0.25f * toe) + rough * 0.3f;
    }
    case kTrousers: {
      const float down = ramp(k.crotch, k.crotch - c.flare_range, a[kZ]);
      return c.thickness + c.flare * down + rough * (0.4f + 0.6f * down);
    }
    case kTop:
    case kJacket: {
      const float sleeve = ramp(0.05f, 0.45f, a[kArm]), hem = a[kArm] > 0.03f ? 0.0f : ramp(k.chest, k.waist - 0.05f, a[kZ]);
      return c.thickness + c.flare * most(hem, 0.6f * sleeve) + rough * (0.4f + 0.6f * most(hem, sleeve));
    }
    default: {
      const float down = ramp(c.high, c.high - 0.25f, a[kZ]);
      return c.thickness + down * (c.flare + rough);
    }
  }
}

}  // namespace soar::people
