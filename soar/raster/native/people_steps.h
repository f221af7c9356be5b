// The three steps of a picture: dress (once per person), pose (once per pose and light), draw (once per view).
#pragma once

#include "people.h"

namespace soar::people {

struct Dress {
  float* rest;         // (P, 3) points of the person's shape, metres
  float *kept, *push;  // per layer vertex, metres: field of keep(), distance from the posed points
};

struct Posed {  // per layer vertex; garments not worn are left as they were
  float *vertices, *normals;          // (V, 3) world, metres; unit
  float *sky, *shadow, *crease;       // shares of sky and key light that arrive; strength of folds
};

struct View {
  float fx, fy, cx, cy;   // pixels
  float T[12];            // camera from world, rows of 3 x 4
  int32_t width, height, samples;  // samples per side of a pixel
};

// Planes of (H, W) floats, channel first; a null pointer is not drawn. One side is the nearest or the farthest surface.
struct Maps {
  float *colour, *normal, *alpha, *depth;         // clothed: 3, 3, 1, 1
  float *skin_normal, *skin_alpha, *skin_depth, *place;  // naked: 3, 1, 1, 3 (mean-shape position)
  int32_t* layer;                                 // clothed: 1; -1 where nothing is
};

void dress(const Geometry& geometry, const Person& person, const float* betas, Dress out);
void pose(const Geometry& geometry, const Person& person, const Dress& dressed, const float* betas, const float* axis_angles,
          const float* translation, const Light& light, Posed out);
void draw(const Geometry& geometry, const Person& person, const Dress& dressed, const Posed& posed, const Light& light,
          const View& view, const Maps* front, const Maps* back, int threads);

}  // namespace soar::people
