/* A template for functions that add whole units to a sum in fixed point (accumulate.h), one for each kind of memory; so
 * there is no include guard. It takes these macros, and undefines them:
 *
 *   ADD_UNITS    the function's name
 *   SUM_SPACE    the address space of the sum
 */
#ifdef CLOUDTOMO_WIDE_ATOMICS
#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
inline void ADD_UNITS(volatile SUM_SPACE Accumulator *sum, Accumulator units)
{
    if (units != OVERFLOWN) {
        const ulong addend = as_ulong(units);
        const ulong after = as_ulong(atom_add(sum, units)) + addend;
        if (after + LARGEST_SUM < 2ul * LARGEST_SUM)
            return;
    }
    atom_xchg(sum, OVERFLOWN);
}
#else
/* Exactly one work item sees each wrap of the low word, and carries it. */
inline void ADD_UNITS(volatile SUM_SPACE Accumulator *sum, Accumulator units)
{
    volatile SUM_SPACE uint *words = (volatile SUM_SPACE uint *)sum;
    if (units != OVERFLOWN) {
        const ulong bits = as_ulong(units);
        const uint low = (uint)bits;
        const uint before = atomic_add(words + LOW_WORD, low);
        const uint high = (uint)(bits >> 32) + (before + low < low);
        if (high == 0u)
            return;
        const uint limit = (uint)(LARGEST_SUM >> 32);
        if (atomic_add(words + 1 - LOW_WORD, high) + high + limit < 2u * limit)
            return;
    }
    atomic_xchg(words + 1 - LOW_WORD, OVERFLOWN_WORD);
}
#endif

#undef ADD_UNITS
#undef SUM_SPACE
