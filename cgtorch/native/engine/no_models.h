/* For environments in Python (engine/models.h). */
#pragma once
#include "models.h"

typedef struct {
  int size;
} Layout;
typedef Layout View;

INLINE Layout layout_of(int64_t size) { return MAKE(Layout){(int)size}; }
INLINE vwhole possible(const void *models, Layout layout, const vec *percept, const vec *control,
                       vwhole rows) {
  (void)models, (void)layout, (void)percept, (void)control;
  return rows & 0;
}
INLINE void next_percept(const void *models, Layout layout, const vec *percept, const vec *control,
                         uint32_t bits, vec *after, vec *novelty) {
  (void)models, (void)control, (void)bits;
  memcpy(after, percept, (size_t)layout.size * sizeof *after);
  *novelty = vec_of(0);
}
INLINE vec chance_of(const void *models, Layout layout, const vec *percept, uint32_t bits) {
  (void)models, (void)layout, (void)percept, (void)bits;
  return vec_of(0);
}
INLINE const vec *looked_at(int64_t kind, Layout layout, const vec *percept, vec *seen, View *view) {
  (void)kind, (void)seen;
  *view = layout;
  return percept;
}
INLINE void said(const void *models, int64_t kind, Layout layout, const vec *percept, const View *view,
                 vwhole rows, vec *out) {
  (void)models, (void)kind, (void)layout, (void)percept, (void)view, (void)rows, (void)out;
}
