// Orders the surfels of one job by depth and lists them per micro-tile.
#include "surfels.h"

namespace soar {
namespace {

// Stable least-significant-digit radix sort by the upper 32 bits. Only the bits in which the keys of this job differ
// are sorted: the depths of a body span few, which leaves two passes of at most 11 bits.
void sort_by_key(uint64_t*& from, uint64_t*& to, uint32_t count) {
  uint32_t lowest = ~0u, highest = 0;
  for (uint32_t i = 0; i < count; ++i) {
    const uint32_t key = (uint32_t)(from[i] >> 32);
    if (key < lowest) lowest = key;
    if (key > highest) highest = key;
  }
  if (count < 2 || lowest == highest) return;
  constexpr int kDigit = 11;
  const int width = 32 - __builtin_clz(highest - lowest);
  for (int shift = 0; shift < width; shift += kDigit) {
    uint32_t begin[1 << kDigit] = {};
    auto digit = [&](uint64_t e) { return (((uint32_t)(e >> 32) - lowest) >> shift) & ((1u << kDigit) - 1); };
    for (uint32_t i = 0; i < count; ++i) ++begin[digit(from[i])];
    uint32_t sum = 0;
    for (uint32_t& b : begin) {
      const uint32_t here = b;
      b = sum;
      sum += here;
    }
    for (uint32_t i = 0; i < count; ++i) to[begin[digit(from[i])]++] = from[i];
    uint64_t* swap = from;
    from = to;
    to = swap;
  }
}

}  // namespace

void bin(Context& t, int64_t job) {
  const uint32_t first = t.job_place[job], count = t.job_place[job + 1] - first;
  const int columns = t.camera.tiles_x(), tiles = columns * kBandTileRows, top = t.band_of(job) * kBandTileRows;
  uint32_t* begin = &t.tile_begin[job * (int64_t)(tiles + 1)];
  std::memset(begin, 0, (tiles + 1) * sizeof(uint32_t));
  if (!count) return;

  uint64_t *entries = &t.entries[first], *other = &t.entries_other[first];
  sort_by_key(entries, other, count);

  Box* boxes = &t.near_boxes[first];
  for (uint32_t i = 0; i < count; ++i) {
    const uint32_t slot = (uint32_t)entries[i], seen = t.owner[slot];
    if (i + 2 * kAhead < count) {
      __builtin_prefetch(&t.owner[(uint32_t)entries[i + 2 * kAhead]]);
      const uint32_t next = t.owner[(uint32_t)entries[i + kAhead]];
      __builtin_prefetch(&t.records[next]);
      __builtin_prefetch(&t.boxes[next]);
    }
    t.place[slot] = first + i;
    t.near_records[first + i] = t.records[seen];
    Box box = t.boxes[seen];  // rows become relative to the band
    box.y0 = (uint16_t)(box.y0 > top ? box.y0 - top : 0);
    box.y1 = (uint16_t)(box.y1 < top + kBandTileRows - 1 ? box.y1 - top : kBandTileRows - 1);
    boxes[i] = box;
    for (int y = box.y0; y <= box.y1; ++y)
      for (int x = box.x0; x <= box.x1; ++x) ++begin[y * columns + x + 1];
  }
  for (int tile = 0; tile < tiles; ++tile) begin[tile + 1] += begin[tile];

  // Filling advances begin[tile] to the tile's end, that is to the next tile's beginning; shifting restores it.
  uint32_t* pairs = &t.pairs[t.job_pair[job]];
  for (uint32_t i = 0; i < count; ++i)
    for (int y = boxes[i].y0; y <= boxes[i].y1; ++y)
      for (int x = boxes[i].x0; x <= boxes[i].x1; ++x) pairs[begin[y * columns + x]++] = i;
  std::memmove(begin + 1, begin, tiles * sizeof(uint32_t));
  begin[0] = 0;
}

}  // namespace soar
