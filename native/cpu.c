// Which of the builds of this library may run here.
#include "common.h"

#if defined(__x86_64__) || defined(_M_X64)
#include <cpuid.h>

// Not __builtin_cpu_supports: without gcc's start-up code, as zig links it, it silently answers no.
static bool has_avx2(void) {
  unsigned a, b, c, d;
  if (!__get_cpuid(1, &a, &b, &c, &d)) return false;
  const unsigned fma = c >> 12 & 1, system_saves_registers = c >> 27 & 1;
  if (!fma || !system_saves_registers) return false;
  __asm__ volatile("xgetbv" : "=a"(a), "=d"(d) : "c"(0));
  const bool vectors_enabled = (a & 6) == 6;
  if (!vectors_enabled || !__get_cpuid_count(7, 0, &a, &b, &c, &d)) return false;
  return b >> 5 & 1;
}
#else
static bool has_avx2(void) { return false; }
#endif

// 1: only the baseline of the platform. 3: x86-64-v3, AVX2 and FMA, both in the processor and enabled by the system.
EXPORT int cpu_level(void) { return has_avx2() ? 3 : 1; }
