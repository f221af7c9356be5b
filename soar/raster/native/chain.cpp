// From the sums over pixels to the gradients of positions, normals, scales, colours and occlusion.
#include "surfels.h"

namespace soar {
namespace {

// Adds up a seen surfel's Sums over its slots in the order of bands, and advances to the next surfel's first slot.
Sums merge(const Context& t, int64_t seen, int passes, uint32_t& slot) {
  float total[16] = {};
  const Box box = t.boxes[seen];
  const int bands = box.y1 / kBandTileRows - box.y0 / kBandTileRows + 1;
  for (int pass = kFront; pass <= kBack; ++pass) {
    if (!(t.sides[seen] & pass)) continue;
    if (passes & pass)
      for (int i = 0; i < bands; ++i) {
        const float* add = t.sums[t.place[slot + i]].colour;
        for (int k = 0; k < 16; ++k) total[k] += add[k];
      }
    slot += bands;
  }
  Sums out;
  std::memcpy(&out, total, sizeof out);
  return out;
}

}  // namespace

void chain(const Context& t, int64_t chunk, int passes, const Surfels& in, const Gradients& out) {
  const int64_t begin = chunk * kChunk, end = begin + kChunk < in.count ? begin + kChunk : in.count, all = end - begin;
  std::memset(out.positions + 3 * begin, 0, 3 * all * sizeof(float));
  std::memset(out.normals + 3 * begin, 0, 3 * all * sizeof(float));
  std::memset(out.scales + begin, 0, all * sizeof(float));
  std::memset(out.colours + 3 * begin, 0, 3 * all * sizeof(float));
  std::memset(out.occlusion + begin, 0, all * sizeof(float));

  const Camera& c = t.camera;
  const f8 fx = splat(c.fx), fy = splat(c.fy), low = splat(t.filter.lowpass), one = splat(1.0f), two = splat(2.0f);
  const int64_t seen_end = begin + t.chunk_seen[chunk];
  uint32_t slot = t.slot_begin[chunk];
  const uint32_t slots = t.job_place[t.jobs];
  for (int64_t first = begin; first < seen_end; first += kLanes) {
    const int count = seen_end - first < kLanes ? (int)(seen_end - first) : kLanes;
    f8 x, y, z = one, n0, n1, n2, s, g[16];
    x = y = n0 = n1 = s = splat(0.0f);
    n2 = -one;
    for (f8& v : g) v = splat(0.0f);
    uint32_t ids[kLanes];
    for (int i = 0; i < count; ++i) {
      const uint32_t id = ids[i] = t.ids[first + i];
      const float *p = in.positions + 3 * (int64_t)id, *n = in.normals + 3 * (int64_t)id;
      x[i] = p[0], y[i] = p[1], z[i] = p[2], n0[i] = n[0], n1[i] = n[1], n2[i] = n[2], s[i] = in.scales[id];
      if (slot + kAhead < slots) __builtin_prefetch(&t.sums[t.place[slot + kAhead]]);
      const Sums sums = merge(t, first + i, passes, slot);
      const float* from = sums.colour;
      for (int k = 0; k < 16; ++k) g[k][i] = from[k];
      for (int k = 0; k < 3; ++k) out.colours[3 * (int64_t)id + k] = sums.colour[k];
      out.occlusion[id] = sums.occlusion;
    }
    const f8 g_depth = g[6], g_depth_dx = g[8], g_depth_dy = g[9];
    const f8 h = g[10], hx = g[11], hy = g[12], hxx = g[13], hxy = g[14], hyy = g[15];
    const Projection p = project(c, t.filter, x, y, z, n0, n1, n2, s);

    // Depth plane z + zx dx + zy dy with zx = -z n0 / (fx c~), zy = -z n1 / (fy c~); no gradient through c~'s clamp.
    const f8 inverse = one / slope_cosine(p.cosine);
    const f8 tx = inverse / fx, ty = inverse / fy;
    const f8 zx = -z * n0 * tx, zy = -z * n1 * ty;
    const f8 unclamped = as_float((i8)(absolute(p.cosine) >= splat(kMinSlopeCosine)) & as_int(one));
    f8 gz = g_depth - (g_depth_dx * n0 * tx + g_depth_dy * n1 * ty);
    f8 gn0 = g[3] - z * tx * g_depth_dx, gn1 = g[4] - z * ty * g_depth_dy, gn2 = g[5];
    f8 g_cosine = -unclamped * inverse * (g_depth_dx * zx + g_depth_dy * zy);

    // Footprint exp(-1/2 d^T Q d), d = pixel - m: dL/dm = Q sum(h d), and the depth plane moves along.
    const f8 q11 = (p.s22 + low) * p.inverse_det, q12 = -p.s12 * p.inverse_det, q22 = (p.s11 + low) * p.inverse_det;
    const f8 g_mx = q11 * hx + q12 * hy - zx * g_depth;
    const f8 g_my = q12 * hx + q22 * hy - zy * g_depth;
    const f8 g_q11 = splat(-0.5f) * hxx, g_q12 = -hxy, g_q22 = splat(-0.5f) * hyy;

    // Q = adj(S + low) / det with det = area^2 + low (s11 + s22) + low^2; opacity = area / sqrt(det). h / opacity is
    // dL/dopacity.
    f8 g_det = -(g_q11 * q11 + g_q12 * q12 + g_q22 * q22) * p.inverse_det;
    f8 g_area = splat(0.0f);
    if (t.filter.compensate) {
      g_det -= splat(0.5f) * h * p.inverse_det;
      g_area = h / p.area;
    }
    g_area += two * p.area * g_det;
    const f8 g_s11 = g_q22 * p.inverse_det + low * g_det, g_s22 = g_q11 * p.inverse_det + low * g_det;
    const f8 g_s12 = -g_q12 * p.inverse_det;

    // s11 = k1^2 (1 + a^2 - u1^2), s12 = k1 k2 (a b - u1 u2), s22 = k2^2 (1 + b^2 - u2^2), area = k1 k2 |cosine|.
    const f8 size = absolute(p.cosine);
    const f8 e11 = one + p.a * p.a - p.u1 * p.u1, e12 = p.a * p.b - p.u1 * p.u2, e22 = one + p.b * p.b - p.u2 * p.u2;
    const f8 g_k1 = two * p.k1 * e11 * g_s11 + p.k2 * (e12 * g_s12 + size * g_area);
    const f8 g_k2 = two * p.k2 * e22 * g_s22 + p.k1 * (e12 * g_s12 + size * g_area);
    g_cosine += select(p.cosine < splat(0.0f), -one, one) * p.k1 * p.k2 * g_area;
    const f8 g_e11 = p.k1 * p.k1 * g_s11, g_e12 = p.k1 * p.k2 * g_s12, g_e22 = p.k2 * p.k2 * g_s22;
    const f8 g_u1 = -(two * p.u1 * g_e11 + p.u2 * g_e12), g_u2 = -(two * p.u2 * g_e22 + p.u1 * g_e12);

    // u1 = n0 - a n2, u2 = n1 - b n2, cosine = n0 a + n1 b + n2; m = (fx a + cx, fy b + cy); k = s f / z; (a, b) = (x, y) / z.
    gn0 += g_u1 + p.a * g_cosine;
    gn1 += g_u2 + p.b * g_cosine;
    gn2 += g_cosine - p.a * g_u1 - p.b * g_u2;
    const f8 ga = two * p.a * g_e11 + p.b * g_e12 - n2 * g_u1 + n0 * g_cosine + fx * g_mx;
    const f8 gb = two * p.b * g_e22 + p.a * g_e12 - n2 * g_u2 + n1 * g_cosine + fy * g_my;
    const f8 g_rate = g_k1 * fx + g_k2 * fy;  // k1 = fx (s / z), k2 = fy (s / z)
    const f8 gx = ga * p.iz, gy = gb * p.iz;
    gz -= (ga * p.a + gb * p.b + g_rate * s * p.iz) * p.iz;
    const f8 gs = g_rate * p.iz;
    for (int i = 0; i < count; ++i) {
      const int64_t id = ids[i];
      float *dp = out.positions + 3 * id, *dn = out.normals + 3 * id;
      dp[0] = gx[i], dp[1] = gy[i], dp[2] = gz[i];
      dn[0] = gn0[i], dn[1] = gn1[i], dn[2] = gn2[i];
      out.scales[id] = gs[i];
    }
  }
}

}  // namespace soar
