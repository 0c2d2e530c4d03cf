/* For every processor; it also says which of the libraries is the best for this one. */
#define OFFPISTE_WIDTH 4
#include "kernels.h"

OFFPISTE_ENTRY_OF(const char*, instruction_set)() {
#ifdef __x86_64__
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq"))
        return "avx512";
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return "avx2";
#endif
    return "baseline";
}
