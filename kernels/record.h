/* What a path leaves behind: radiance, and an account of its weight.
 *
 * Every path starts with the weight 1, and every bit of it ends in one of the fates (the enum
 * Fate, in cloudtomo_cl/layout.py): the audit compares their sum with the number of paths. */
#ifndef CLOUDTOMO_RECORD_H
#define CLOUDTOMO_RECORD_H

#include "accumulate.h"
#include "grid.h"

/* WEIGHT_UNIT: fixed-point units of a weight of 1. Work groups add into one of ACCOUNT_COPIES
 * copies of the account, lest all wait for one address. Both from cloudtomo_cl/layout.py. */

typedef struct {
    float radiance; /* local estimates so far, sr^-1 */
    float removed;  /* by truncation, sr^-1 */
    bool lost;
#ifdef CLOUDTOMO_REPLAY
    float total;    /* the whole path's radiance, sr^-1 */
    float adjoint;  /* derivative of the cost with respect to this path's radiance, scaled */
    volatile __global Accumulator *gradient;
#else
    float absorbed;        /* weight, by droplets and molecules */
    float surface;         /* weight, by the surface */
    float killed;          /* less the weight that survived roulettes have given */
    float killed_variance;
    volatile __global Accumulator *account; /* [copy][Fate] */
#ifdef CLOUDTOMO_FLUX
    volatile __global Accumulator *columns; /* weights, [Flux][x][y] */
#endif
#endif
} Record;

inline void record_begin(Record *record)
{
    record->radiance = 0.0f;
    record->removed = 0.0f;
    record->lost = false;
#ifndef CLOUDTOMO_REPLAY
    record->absorbed = 0.0f;
    record->surface = 0.0f;
    record->killed = 0.0f;
    record->killed_variance = 0.0f;
#endif
}

#ifdef CLOUDTOMO_REPLAY
/* Radiance that this path has still to gather; rounding counts as nothing. */
inline float remaining(const Record *record)
{
    const float rest = record->total - record->radiance;
    return rest > 4.0f * FLT_EPSILON * record->total ? rest : 0.0f;
}
inline void deposit(Record *record, int index, float value)
{
    accumulate(record->gradient + index, record->adjoint * value);
}
#define DEPOSIT_CROSSING(index, length, carried) \
    if ((carried) != 0.0f) deposit(record, index, -(length) * (carried))
#define DEPOSIT_COLLISION(index, extinction, carried) \
    if ((carried) != 0.0f) deposit(record, index, (carried) / (extinction))
#else
inline float remaining(const Record *record) { return 0.0f; }
#define DEPOSIT_CROSSING(index, length, carried)
#define DEPOSIT_COLLISION(index, extinction, carried)
#endif

/* Adds a weight to the column that holds a position (in voxel units). */
inline void tally_column(const __constant Scene *scene, const Record *record, Flux flux, float3 position, float weight)
{
#ifdef CLOUDTOMO_FLUX
    const int2 last = (int2)(scene->shape[0], scene->shape[1]) - 1;
    const int2 column = clamp(convert_int2(wrapped(scene, position).xy), (int2)(0), last);
    const int index = ((int)flux * scene->shape[0] + column.x) * scene->shape[1] + column.y;
    accumulate(record->columns + index, weight * WEIGHT_UNIT);
#endif
}

inline void account_absorbed(Record *record, float weight)
{
#ifndef CLOUDTOMO_REPLAY
    record->absorbed += weight;
#endif
}

inline void account_surface(Record *record, float weight)
{
#ifndef CLOUDTOMO_REPLAY
    record->surface += weight;
#endif
}

/* A roulette between `weight` and `raised`, or nothing. */
inline void account_roulette(Record *record, float weight, float raised, bool survives)
{
#ifndef CLOUDTOMO_REPLAY
    record->killed_variance += weight * (raised - weight);
    if (survives)
        record->killed -= raised - weight;
#endif
}

/* Closes the account of a path that ended with a weight in some fate. */
inline void account_end(const Record *record, Fate fate, float weight)
{
#ifndef CLOUDTOMO_REPLAY
    volatile __global Accumulator *account = record->account + (get_group_id(0) % ACCOUNT_COPIES) * FATES;
    accumulate(account + FATE_LAUNCHED, WEIGHT_UNIT);
    accumulate(account + fate, weight * WEIGHT_UNIT);
    if (record->absorbed != 0.0f)
        accumulate(account + FATE_ABSORBED, record->absorbed * WEIGHT_UNIT);
    if (record->surface != 0.0f)
        accumulate(account + FATE_SURFACE, record->surface * WEIGHT_UNIT);
    if (record->killed_variance != 0.0f) {
        accumulate(account + FATE_KILLED, record->killed * WEIGHT_UNIT);
        accumulate(account + FATE_KILLED_VARIANCE, record->killed_variance * WEIGHT_UNIT);
    }
    if (record->removed != 0.0f)
        accumulate(account + FATE_TRUNCATED, record->removed * WEIGHT_UNIT);
#endif
}

#endif
