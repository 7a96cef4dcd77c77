/* The initial state of rollouts that wait for Python, the requests to Python, and rollouts in environments in
   Python, where there are no models (models.h). */
#include "models.h"

typedef struct {
  int size;
} Layout;
typedef Layout View;

INLINE Layout layout_of(int64_t size) { return MAKE(Layout){(int)size}; }
INLINE vwhole possible(const void *models, Layout layout, const vec *percept, const vec *control,
                       vwhole rows) {
  return rows & 0;
}
INLINE void next_percept(const void *models, Layout layout, const vec *percept, const vec *control,
                         uint32_t bits, vec *after, vec *novelty) {
  memcpy(after, percept, (size_t)layout.size * sizeof *after);
  *novelty = vec_of(0);
}
INLINE vec chance_of(const void *models, Layout layout, const vec *percept, uint32_t bits) {
  return vec_of(0);
}
INLINE const vec *looked_at(int64_t kind, Layout layout, const vec *percept, vec *seen, View *view) {
  *view = layout;
  return percept;
}
INLINE void said(const void *models, int64_t kind, Layout layout, const vec *percept, const View *view,
                 vwhole rows, vec *out) {
}

#include "resumable.h"

EXPORT_STRUCT(Waiting)
EXPORT_CONSTANTS(waiting_limits, SHARE)

/* All nodes of some graphs in one table. */
static void lay_out(void *what, int64_t begin, int64_t end) {
  Waiting *w = what;
  const Program *p = w->program;
  for (int64_t graph = begin; graph < end; graph++) {
    if (!good(p, graph, &w->wrong)) continue;
    GraphRows g = graph_of(p, graph);
    for (int64_t place = 0; place < p->nodes; place++) {
      int64_t row = graph * p->nodes + place;
      w->kinds[row] = (int32_t)kind_of(p, g, p->rows + place);
      for (int64_t o = 0; o < p->outcomes; o++) {
        int64_t head = head_of(p, g, p->rows + place, o);
        Successor successor = {(int32_t)head, -1};
        if (head >= 0) {
          successor.kind = (int32_t)kind_of(p, g, head);
          successor.head = (int32_t)(head - p->rows + graph * p->nodes);
        }
        w->successors[row * p->outcomes + o] = successor;
      }
    }
  }
}

static void begin_lanes(void *what, int64_t begin, int64_t end) {
  Waiting *w = what;
  const Program *p = w->program;
  for (int64_t i = begin; i < end; i++) {
    int64_t graph = i / w->count;
    int32_t first = (int32_t)(graph * p->nodes), start = (int32_t)p->start[graph];
    int64_t from = i % w->firsts;
    copied_row(w->first_percept + from * w->percept_size, w->percept + i * w->percept_size,
               w->percept_size);
    memcpy(w->state + i * w->state_bytes, w->first_state + from * w->state_bytes,
           (size_t)w->state_bytes);
    w->places[i] = (Place){.node = first + start, .first = first, .left = (int32_t)w->max_transitions};
    enter_skills(w, i);
  }
}

/* Prepares all graphs; WRONG_GRAPHS if a number is not a valid node or action. */
int begin_waiting(Waiting *w, int64_t threads) {
  const Program *p = w->program;
  int64_t own = w->graphs * p->nodes;
  in_parallel(lay_out, w, w->graphs, 256, threads);
  if (w->wrong) return WRONG_GRAPHS;
  for (int64_t row = 0; row < p->rows; row++) {
    w->kinds[own + row] = (int32_t)p->kind[row];
    for (int64_t o = 0; o < p->outcomes; o++) {
      int64_t head = p->heads[row * p->outcomes + o];
      Successor successor = {(int32_t)(head < 0 ? head : head + own), head < 0 ? -1 : (int32_t)p->kind[head]};
      w->successors[(own + row) * p->outcomes + o] = successor;
    }
  }
  size_t lanes = (size_t)(w->graphs * w->count);
  large_pages(w->places, lanes * sizeof *w->places);
  large_pages(w->percept, lanes * (size_t)w->percept_size * sizeof(real));
  large_pages(w->state, lanes * (size_t)w->state_bytes);
  large_pages(w->message, lanes * (size_t)w->message_size * sizeof(real));
  large_pages(w->queue, lanes * (size_t)p->count * sizeof *w->queue);
  large_pages(w->step, lanes * sizeof *w->step);
  in_parallel(begin_lanes, w, w->graphs * w->count, SHARE, threads);
  return DONE;
}

/* Copies the parameters of lane i's node, unless they are there from the last time. */
static inline void ask_parameters(const Waiting *w, int64_t k, int64_t i) {
  const Program *p = w->program;
  int64_t size = p->primitives[w->kind].outputs, own = w->graphs * p->nodes;
  real *to = (real *)(intptr_t)w->parameters[w->kind];
  int32_t *held = (int32_t *)(intptr_t)w->held[w->kind], node = w->places[i].node;
  if (!to || held[k] == node) return;
  const real *from = node < own ? p->parameters + node * p->each : p->learned + (node - own) * p->width;
  copied_row(from, to + k * size, size);
  held[k] = node;
}

static inline void ask_row(const Waiting *w, int64_t k, int64_t i) {
  const int64_t *part = w->memory + 2 * w->kind;
  w->asked_scenario[k] = w->first_scenario[i % w->firsts], w->asked_step[k] = w->places[i].step;
  w->asked_has[k] = w->has_message[i];
  copied_row(w->percept + i * w->percept_size, w->asked_percept + k * w->percept_size, w->percept_size);
  copied_row(w->message + i * w->message_size, w->asked_message + k * w->message_size, w->message_size);
  copied_row(w->common + i * w->memory_size + part[0], w->asked_memory + k * part[1], part[1]);
  if (w->state_is_real)
    copied_row((const real *)(w->state + i * w->state_bytes),
               (real *)(w->asked_state + k * w->state_bytes), w->state_bytes / (int64_t)sizeof(real));
  else memcpy(w->asked_state + k * w->state_bytes, w->state + i * w->state_bytes, (size_t)w->state_bytes);
}

static void ask_share(void *what, int64_t begin, int64_t end) {
  Waiting *w = what;
  (void)end;
  int64_t share = begin / SHARE, kinds = w->program->count, lanes = w->graphs * w->count, silent = 0;
  const int32_t *queue = w->queue + w->kind * lanes + begin;
  for (int64_t at = 0; at < w->waiting[share * kinds + w->kind]; at++) {
    int64_t i = w->everyone ? begin + at : queue[at], k = w->offset[share] + at;
    ask_parameters(w, k, i);
    if (w->everyone) w->step[i] = w->places[i].step;
    else ask_row(w, k, i);
    silent += !w->has_message[i];
  }
  __atomic_fetch_add(&w->silent, silent, __ATOMIC_RELAXED);
}

/* Requests the action for which most lanes wait. */
int ask_python(Waiting *w, int64_t threads) {
  int64_t kinds = w->program->count, lanes = w->graphs * w->count;
  int64_t shares = (lanes + SHARE - 1) / SHARE;
  w->kind = -1, w->asked = w->silent = 0;
  for (int64_t k = 0; k < kinds; k++) {
    int64_t count = 0;
    for (int64_t share = 0; share < shares; share++) count += w->waiting[share * kinds + k];
    if (count > w->asked) w->kind = k, w->asked = count;
  }
  w->everyone = w->asked == lanes;
  for (int64_t share = 0, next = 0; w->kind >= 0 && share < shares; share++) {
    w->offset[share] = next;
    next += w->waiting[share * kinds + w->kind];
  }
  if (w->kind >= 0) in_parallel(ask_share, w, lanes, SHARE, threads);
  return DONE;
}

int worlds_resumed(Waiting *w, int64_t threads) {
  in_parallel(run_share, w, w->graphs * w->count, SHARE, threads);
  return ask_python(w, threads);
}
