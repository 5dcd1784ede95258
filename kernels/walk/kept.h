/* Where the state of a path in flight is kept.
 *
 * On CPUs it is in ordinary variables. NVIDIA's GPUs lack registers for it: there (CLOUDTOMO_KEEPS_LOCAL) it lies in
 * local memory, and is volatile, so that compilers do not load it before the flights. The state of a work item has an
 * odd number of 32-bit words, so that the states of a group's items lie in different memory banks.
 *
 *   KEPT                         qualifier of the state's type
 *   KEPT_FOR_ITEM(type, name)    declares `name`, a pointer to this work item's state; in a kernel, not in a branch
 *   KEPT_TOGETHER(...)           the same for three types and names, next to each other in memory
 */
#ifndef CLOUDTOMO_KEPT_H
#define CLOUDTOMO_KEPT_H

#ifdef CLOUDTOMO_KEEPS_LOCAL
#define KEPT volatile __local
#define KEPT_FOR_ITEM(type, name) \
    __local type name##_of_items[WORK_GROUP_SIZE]; \
    KEPT type *const name = name##_of_items + get_local_id(0)
#define KEPT_TOGETHER(type1, name1, type2, name2, type3, name3) \
    __local struct { \
        type1 name1; \
        type2 name2; \
        type3 name3; \
    } name1##_of_items[WORK_GROUP_SIZE]; \
    KEPT type1 *const name1 = &name1##_of_items[get_local_id(0)].name1; \
    KEPT type2 *const name2 = &name1##_of_items[get_local_id(0)].name2; \
    KEPT type3 *const name3 = &name1##_of_items[get_local_id(0)].name3
typedef struct {
    float x, y, z;
} KeptVector;
typedef struct {
    int x, y, z;
} KeptVoxel;

inline float3 kept_vector(const KEPT KeptVector *kept) { return (float3)(kept->x, kept->y, kept->z); }

inline void keep_vector(KEPT KeptVector *kept, float3 vector)
{
    kept->x = vector.x;
    kept->y = vector.y;
    kept->z = vector.z;
}
#else
#define KEPT
#define KEPT_FOR_ITEM(type, name) \
    type name##_of_item; \
    type *const name = &name##_of_item
#define KEPT_TOGETHER(type1, name1, type2, name2, type3, name3) \
    KEPT_FOR_ITEM(type1, name1); \
    KEPT_FOR_ITEM(type2, name2); \
    KEPT_FOR_ITEM(type3, name3)
typedef float3 KeptVector;
typedef int3 KeptVoxel;

inline float3 kept_vector(const KeptVector *kept) { return *kept; }

inline void keep_vector(KeptVector *kept, float3 vector) { *kept = vector; }
#endif

#endif
