// The C interface of the surfel rasteriser. Arrays are contiguous float32; images are planar (9, height, width).
#include <memory>
#include <mutex>

#if defined(__AVX2__)
#include <cpuid.h>
#endif

#include "surfels.h"

#define SOAR_API extern "C" __attribute__((visibility("default")))

namespace {

// Contexts return here with their memory, so that the next view faults no fresh pages.
constexpr size_t kPooled = 4;
std::mutex pool_mutex;
std::vector<std::unique_ptr<soar::Context>> pool;

std::unique_ptr<soar::Context> take() {
  std::lock_guard<std::mutex> lock(pool_mutex);
  if (pool.empty()) return std::unique_ptr<soar::Context>(new soar::Context);
  auto context = std::move(pool.back());
  pool.pop_back();
  return context;
}

}  // namespace

// Whether this machine can run the library, which is compiled for x86-64-v3 on x86-64. Asked of the processor itself:
// __builtin_cpu_supports finds its tables empty in a shared library that zig links.
SOAR_API int soar_supported() {
#if defined(__AVX2__)
  unsigned a, b, c, d;
  if (!__get_cpuid(1, &a, &b, &c, &d)) return 0;
  const bool fma = c & bit_FMA, saved = c & bit_OSXSAVE;
  if (!fma || !saved || !__get_cpuid_count(7, 0, &a, &b, &c, &d) || !(b & bit_AVX2)) return 0;
  unsigned low, high;
  __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return (low & 6) == 6;  // the operating system keeps the vector registers
#else
  return 1;
#endif
}

// Renders the passes whose planes are not null. Returns a context for soar_surfels_backward, to be given back with
// soar_surfels_release, or null when memory ran out.
SOAR_API void* soar_surfels_forward(const float* positions, const float* normals, const float* scales, const float* colours,
                                    const float* occlusion, int64_t count, const float* intrinsics, int width, int height,
                                    float lowpass, int compensate, int cull, float* front, float* back, int threads) try {
  using namespace soar;
  auto context = take();
  Context& t = *context;
  t.camera = {intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3], width, height};
  t.filter = {lowpass, compensate != 0, cull != 0};
  t.passes = (front ? kFront : 0) | (back ? kBack : 0);
  Team team(threads);
  prepare(t, {positions, normals, scales, colours, occlusion, count}, team);
  team.run(t.jobs, [&](int64_t job) {
    bin(t, job);
    compose(t, job, t.pass_of(job) == kFront ? front : back);
  });
  return context.release();
} catch (const std::exception&) {
  return nullptr;
}

// Gradients of the five inputs from those of the planes; a pass whose gradient is null adds nothing. Returns 0 when
// memory ran out. Not to be called twice at once for one context.
SOAR_API int soar_surfels_backward(void* handle, const float* positions, const float* normals, const float* scales,
                                   const float* colours, const float* occlusion, int64_t count, const float* front,
                                   const float* back, const float* g_front, const float* g_back, float* g_positions,
                                   float* g_normals, float* g_scales, float* g_colours, float* g_occlusion, int threads) try {
  using namespace soar;
  Context& t = *static_cast<Context*>(handle);
  const int passes = t.passes & ((g_front ? kFront : 0) | (g_back ? kBack : 0));
  t.sums.need(t.job_place[t.jobs]);
  Team team(threads);
  team.run(t.jobs, [&](int64_t job) {
    const int pass = t.pass_of(job);
    if (pass & passes) gather(t, job, pass == kFront ? front : back, pass == kFront ? g_front : g_back);
  });
  const Surfels surfels = {positions, normals, scales, colours, occlusion, count};
  team.run(t.chunks, [&](int64_t chunk) {
    chain(t, chunk, passes, surfels, {g_positions, g_normals, g_scales, g_colours, g_occlusion});
  });
  return 1;
} catch (const std::exception&) {
  return 0;
}

SOAR_API void soar_surfels_release(void* handle) {
  std::unique_ptr<soar::Context> context(static_cast<soar::Context*>(handle));
  std::lock_guard<std::mutex> lock(pool_mutex);
  if (pool.size() < kPooled) pool.push_back(std::move(context));
}
