// What Python calls. Every pointer stays the caller's; a call returns 0 when memory ran out.
#include "people_steps.h"

#define SOAR_EXPORT extern "C" __attribute__((visibility("default")))

using namespace soar::people;

// Floats of the records that Python fills, in the order Anchors, Person, Cloth, Light; bytes of Geometry, View, Maps.
SOAR_EXPORT void soar_people_sizes(int64_t* out) {
  const int64_t sizes[] = {sizeof(Anchors) / 4, sizeof(Person) / 4, sizeof(Cloth) / 4, sizeof(Light) / 4,
                           sizeof(Geometry),    sizeof(View),       sizeof(Maps)};
  std::memcpy(out, sizes, sizeof sizes);
}

SOAR_EXPORT int soar_people_dress(const Geometry* geometry, const Person* person, const float* betas, Dress dressed) try {
  dress(*geometry, *person, betas, dressed);
  return 1;
} catch (const std::exception&) {
  return 0;
}

SOAR_EXPORT int soar_people_pose(const Geometry* geometry, const Person* person, Dress dressed, const float* betas,
                                 const float* axis_angles, const float* translation, const Light* light, Posed posed) try {
  pose(*geometry, *person, dressed, betas, axis_angles, translation, *light, posed);
  return 1;
} catch (const std::exception&) {
  return 0;
}

SOAR_EXPORT int soar_people_draw(const Geometry* geometry, const Person* person, Dress dressed, Posed posed, const Light* light,
                                 const View* view, const Maps* front, const Maps* back, int threads) try {
  draw(*geometry, *person, dressed, posed, *light, *view, front, back, threads);
  return 1;
} catch (const std::exception&) {
  return 0;
}
