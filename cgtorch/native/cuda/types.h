/* Declarations of standard headers, which NVRTC lacks. */
#pragma once

typedef signed char int8_t;
typedef unsigned char uint8_t;
typedef short int16_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
typedef unsigned long long uint64_t;
typedef long long intptr_t;

#define INFINITY __int_as_float(0x7F800000)
#define NAN __int_as_float(0x7FC00000)
#define INT64_MAX 0x7FFFFFFFFFFFFFFFLL
#ifndef NULL
#define NULL nullptr
#endif
