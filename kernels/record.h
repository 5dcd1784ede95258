/* What a path leaves behind: radiance, and an account of its weight.
 *
 * Every path starts with the weight 1, and every bit of it ends in one of the fates (the enum
 * Fate, in cloudtomo_cl/layout.py): the audit compares their sum with the number of paths. */
#ifndef CLOUDTOMO_RECORD_H
#define CLOUDTOMO_RECORD_H

#include "accumulate.h"
#include "grid.h"

/* WEIGHT_UNIT: fixed-point units of a weight of 1, FIELD_UNIT of 1 km or sr^-1 km. Work groups add into one of ACCOUNT_COPIES
 * copies of the account, lest all wait for one address. Both from cloudtomo_cl/layout.py. */

typedef struct {
    float radiance; /* local estimates so far, sr^-1 */
    float removed;  /* by truncation, sr^-1 */
    bool lost;
#ifdef CLOUDTOMO_EVENTS_COUNTED
    __global ushort *crossings; /* by event; later ones than are counted in the last: scripts/divergence.py */
    uint event;
#endif
#if defined(CLOUDTOMO_REPLAY) || defined(CLOUDTOMO_FIELD)
    float total;    /* the whole path's radiance, sr^-1 */
    float adjoint;  /* derivative of the cost with respect to this path's radiance, scaled */
    volatile __global Accumulator *gradient;
#ifdef CLOUDTOMO_FIELD
    const __global int *column; /* see field.cl */
    const __global float *scattered;
    const __global float *sunlight;
    volatile __global Accumulator *field;
    const __global float *change;
    float tangent; /* derivative of the path's radiance along `change`, sr^-1 */
#ifdef CLOUDTOMO_JACOBIAN
    /* [column]: the pixel's derivatives, by its paths' first flights and by all that follows, sr^-1 km */
    __global float *first_row, *later_row;
#endif
#endif
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
#if !defined(CLOUDTOMO_REPLAY) && !defined(CLOUDTOMO_FIELD)
    record->absorbed = 0.0f;
    record->surface = 0.0f;
    record->killed = 0.0f;
    record->killed_variance = 0.0f;
#endif
}

/* For scripts/divergence.py: nothing elsewhere. */
inline void count_event(Record *record, uint event)
{
#ifdef CLOUDTOMO_EVENTS_COUNTED
    record->event = event < CLOUDTOMO_EVENTS_COUNTED ? event : CLOUDTOMO_EVENTS_COUNTED;
#endif
}

inline void count_crossing(Record *record)
{
#ifdef CLOUDTOMO_EVENTS_COUNTED
    ++record->crossings[record->event - 1u];
#endif
}

#if defined(CLOUDTOMO_REPLAY) || defined(CLOUDTOMO_FIELD)
/* Radiance that this path has still to gather; rounding counts as nothing. */
inline float remaining(const Record *record)
{
    const float rest = record->total - record->radiance;
    return rest > 4.0f * FLT_EPSILON * record->total ? rest : 0.0f;
}
#else
inline float remaining(const Record *record) { return 0.0f; }
#endif

/* What a flight brings along, for its crossings to deposit. */
#ifdef CLOUDTOMO_FIELD
typedef struct {
    float to_sun;      /* a way to the sun: the radiance it brings, sr^-1 */
    float importance;  /* else: weight with which the flight's radiance counts in the pixel */
    float sun_density; /* of scattering by droplets from the sun into the flight, sr^-1 */
    int bin;           /* of its direction */
    float weight;      /* of the flight as a sample of the radiance field; 0: none */
    float arriving;    /* radiance x weight that it brings, sr^-1 */
    bool is_first;     /* from the camera */
} Carried;
inline Carried nothing_carried(void)
{
    const Carried nothing = {0.0f, 0.0f, 0.0f, 0, 0.0f, 0.0f, false};
    return nothing;
}
inline Carried carried_to_sun(float radiance)
{
    Carried carried = nothing_carried();
    carried.to_sun = radiance;
    return carried;
}
#else
typedef float Carried; /* the radiance that depends on the flight, sr^-1 */
inline Carried nothing_carried(void) { return 0.0f; }
inline Carried carried_to_sun(float radiance) { return radiance; }
#endif

inline void deposit_crossing(Record *record, int index, float length, Carried carried)
{
#if defined(CLOUDTOMO_REPLAY)
    if (carried != 0.0f)
        accumulate(record->gradient + index, -record->adjoint * length * carried);
#elif defined(CLOUDTOMO_FIELD)
    if (carried.to_sun == 0.0f && carried.importance == 0.0f && carried.weight == 0.0f)
        return;
    const int column = record->column[index];
    if (column < 0)
        return;
    const int place = column * DIRECTION_BINS + carried.bin;
    const float source = record->scattered[place] + carried.sun_density * record->sunlight[column];
    const float derivative = length * (carried.importance * source - carried.to_sun);
#ifdef CLOUDTOMO_JACOBIAN
    (carried.is_first ? record->first_row : record->later_row)[column] += derivative;
#else
    record->tangent += derivative * record->change[index];
    if (record->adjoint != 0.0f)
        accumulate(record->gradient + index, record->adjoint * derivative);
#endif
    if (carried.weight > 0.0f) {
        accumulate(record->field + 2 * place, FIELD_UNIT * length * carried.weight);
        accumulate(record->field + 2 * place + 1, FIELD_UNIT * length * carried.arriving);
    }
#endif
}

/* A collision with a droplet. */
inline void deposit_collision(Record *record, int index, float extinction, Carried carried)
{
#ifdef CLOUDTOMO_REPLAY
    if (carried != 0.0f)
        accumulate(record->gradient + index, record->adjoint * (carried / extinction));
#endif
}

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
#if !defined(CLOUDTOMO_REPLAY) && !defined(CLOUDTOMO_FIELD)
    record->absorbed += weight;
#endif
}

inline void account_surface(Record *record, float weight)
{
#if !defined(CLOUDTOMO_REPLAY) && !defined(CLOUDTOMO_FIELD)
    record->surface += weight;
#endif
}

/* A roulette between `weight` and `raised`, or nothing. */
inline void account_roulette(Record *record, float weight, float raised, bool survives)
{
#if !defined(CLOUDTOMO_REPLAY) && !defined(CLOUDTOMO_FIELD)
    record->killed_variance += weight * (raised - weight);
    if (survives)
        record->killed -= raised - weight;
#endif
}

/* Closes the account of a path that ended with a weight in some fate. */
inline void account_end(const Record *record, Fate fate, float weight)
{
#if !defined(CLOUDTOMO_REPLAY) && !defined(CLOUDTOMO_FIELD)
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
