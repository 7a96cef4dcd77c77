/* What a library says of itself, so that Python can be sure to read the sources as the compiler did
   (cgtorch.native.interface). */
#ifndef CGTORCH_EXPORTED_H
#define CGTORCH_EXPORTED_H
#include <stdint.h>

#define EXPORT_STRUCT(name) const int64_t size_of_##name = sizeof(name);
#define EXPORT_CONSTANTS(group, ...)            \
  const char names_of_##group[] = #__VA_ARGS__; \
  const int64_t values_of_##group[] = {__VA_ARGS__};

/* What functions return. */
enum { DONE, NO_MEMORY, WRONG_GRAPHS, NO_PARENT };
#endif
