// Builds of this library that may run here, and the sources and version that it was made from.
#include "common.h"

#if defined(__x86_64__) || defined(_M_X64)
#include <cpuid.h>

// Not __builtin_cpu_supports: without gcc's start-up code, as zig links it, it silently answers no.
static int level(void) {
  unsigned a, b, c, d;
  if (!__get_cpuid(1, &a, &b, &c, &d)) return 1;
  const unsigned fma = c >> 12 & 1, system_saves_registers = c >> 27 & 1;
  if (!fma || !system_saves_registers) return 1;
  __asm__ volatile("xgetbv" : "=a"(a), "=d"(d) : "c"(0));
  const bool avx_enabled = (a & 6) == 6, avx512_enabled = (a & 0xE6) == 0xE6;
  if (!avx_enabled || !__get_cpuid_count(7, 0, &a, &b, &c, &d) || !(b >> 5 & 1)) return 1;
  const unsigned parts = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;  // of AVX-512: F, DQ, CD, BW, VL
  return avx512_enabled && (b & parts) == parts ? 4 : 3;
}
#else
static int level(void) { return 1; }
#endif

// 1: only the baseline of the platform. 3: x86-64-v3, AVX2 and FMA, both in the processor and enabled by the system. 4: x86-64-v4,
// AVX-512 besides.
EXPORT int cpu_level(void) { return level(); }

#ifndef SOURCES_DIGEST
#define SOURCES_DIGEST 0
#endif
#ifndef VERSION_DIGEST
#define VERSION_DIGEST 0
#endif

// The values that hatch_build.py counted when it compiled; see src/gelform/_native/sources.py.
EXPORT int sources_digest(void) { return (int)SOURCES_DIGEST; }
EXPORT int version_digest(void) { return (int)VERSION_DIGEST; }
