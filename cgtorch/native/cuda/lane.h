/* The vectors of real.h for a GPU, where a thread has one lane: a number, or the result of a comparison, 0 or
   -1. Operations round as on the CPU, in the same order. */
#pragma once

#define WIDTH 1
#define BYTES sizeof(real)
#define UNROLLED _Pragma("unroll")
#define UP_TO(i, count, most) \
  _Pragma("unroll") for (int i = 0; i < (most); i++) if (i < (int)(count))
#define MAKE(type) type
#define KERNEL extern "C" __global__ void
#define WARP 32
#ifndef DYNAMIC_SHARED
#define DYNAMIC_SHARED extern __shared__
#endif
#define SET(flag) (*(flag) = 1)
#define APART INLINE
#define MEMBER inline __attribute__((always_inline))
#define EACH(result, part)            \
  do {                                \
    const int i = 0;                  \
    result[i] = part;                 \
  } while (0)

struct vec;
struct vwhole {
  whole part;
  vwhole() = default;
  MEMBER vwhole(whole x) : part(x) {}
  explicit MEMBER operator vec() const;
  MEMBER whole &operator[](int) { return part; }
  MEMBER whole operator[](int) const { return part; }
};
struct vec {
  real part;
  vec() = default;
  MEMBER vec(real x) : part(x) {}
  explicit MEMBER operator vwhole() const {
    whole bits;
    memcpy(&bits, &part, sizeof bits);
    return vwhole(bits);
  }
  MEMBER real &operator[](int) { return part; }
  MEMBER real operator[](int) const { return part; }
};
MEMBER vwhole::operator vec() const {
  real x;
  memcpy(&x, &part, sizeof x);
  return vec(x);
}

#define OPERATOR(type, op)                                                 \
  INLINE type operator op(type a, type b) { return type(a.part op b.part); } \
  INLINE type &operator op##=(type &a, type b) { return a = a op b; }
OPERATOR(vec, +)
OPERATOR(vec, -)
OPERATOR(vec, *)
OPERATOR(vec, /)
OPERATOR(vwhole, +)
OPERATOR(vwhole, -)
OPERATOR(vwhole, &)
OPERATOR(vwhole, |)
OPERATOR(vwhole, ^)
#define COMPARISON(op)                                                              \
  INLINE vwhole operator op(vec a, vec b) { return vwhole(a.part op b.part ? -1 : 0); } \
  INLINE vwhole operator op(vwhole a, vwhole b) { return vwhole(a.part op b.part ? -1 : 0); }
COMPARISON(<)
COMPARISON(<=)
COMPARISON(>)
COMPARISON(>=)
COMPARISON(==)
COMPARISON(!=)
INLINE vec operator-(vec a) { return vec(-a.part); }
INLINE vwhole operator~(vwhole a) { return vwhole(~a.part); }
#ifdef REAL_IS_FLOAT
INLINE vwhole operator<<(vwhole a, int by) { return vwhole((whole)((uint32_t)a.part << by)); }
#else
INLINE vwhole operator<<(vwhole a, int by) { return vwhole((whole)((uint64_t)a.part << by)); }
#endif
INLINE vwhole operator>>(vwhole a, int by) { return vwhole(a.part >> by); }

INLINE vec load(const real *p) { return vec(*p); }
INLINE void store(real *p, vec v) { *p = v.part; }
INLINE vec vec_of(real x) { return vec(x); }
INLINE vec as_numbers(vwhole x) { return vec((real)x.part); }
INLINE vwhole every(whole x) { return vwhole(x); }
INLINE vec select_vec(vwhole yes, vec a, vec b) { return yes.part ? a : b; }
INLINE vwhole select_whole(vwhole yes, vwhole a, vwhole b) { return yes.part ? a : b; }
INLINE vec vec_max(vec a, vec b) { return a.part > b.part ? a : b; }
INLINE vec vec_min(vec a, vec b) { return a.part < b.part ? a : b; }
INLINE vec vec_sqrt(vec a) { return vec(FN(sqrt)(a.part)); }
INLINE vec vec_floor(vec a) { return vec(FN(floor)(a.part)); }
INLINE vec vec_fma(vec a, vec b, vec c) { return vec(FN(fma)(a.part, b.part, c.part)); }

#define EVERYONE 0xFFFFFFFFu /* the threads of a warp */
INLINE int thread_of_warp(void) { return (int)(threadIdx.x % WARP); }
INLINE uint32_t bits_of(vwhole yes) { return yes.part < 0; }
INLINE int first_of(uint32_t bits) { return (void)bits, 0; }
/* The threads of a warp evaluate models together, so all of them take part if one has to. */
INLINE int any_of(uint32_t bits) { return __any_sync(EVERYONE, bits != 0); }
