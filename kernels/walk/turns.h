/* Which paths a work item walks.
 *
 * On CPUs it walks one path. On GPUs work items run in lockstep, and after its path a work item would wait for the
 * longest path of its neighbours. There (CLOUDTOMO_REGENERATES) a work group has `turns` times as many paths as work
 * items, and a work item whose path has ended takes the next free path. Which work item takes which path is random, but
 * no result depends on it.
 *
 *   TURNS(name, end)    declares the turns of a kernel whose paths are the items below `end`; not in a branch
 *   next_turn(&name)    takes another path, name.item; false if there is none
 *   REGENERATES         whether a work item looks for another path after every event, not only after its path
 */
#ifndef CLOUDTOMO_TURNS_H
#define CLOUDTOMO_TURNS_H

#ifdef CLOUDTOMO_REGENERATES
#define REGENERATES true
typedef struct {
    volatile __local uint *taken; /* number of paths that the group has taken so far */
    uint first, end;              /* range of the group's paths */
    uint item;
} Turns;

#define TURNS(name, end) \
    __local uint name##_taken; \
    Turns name = group_turns(&name##_taken, turns, end)

inline Turns group_turns(volatile __local uint *taken, uint turns, uint end)
{
    const uint count = (uint)get_local_size(0) * turns;
    Turns group = {taken, (uint)(get_global_offset(0) + get_group_id(0) * count), 0u, 0u};
    group.end = min(group.first + count, end);
    if (get_local_id(0) == 0)
        *taken = 0u;
    barrier(CLK_LOCAL_MEM_FENCE);
    return group;
}

inline bool next_turn(Turns *group)
{
    group->item = group->first + atomic_inc(group->taken);
    return group->item < group->end;
}
#else
#define REGENERATES false
typedef struct {
    uint end, item;
    bool begun;
} Turns;

#define TURNS(name, end) Turns name = {end, (uint)get_global_id(0), false}

inline bool next_turn(Turns *own)
{
    const bool is_first = !own->begun;
    own->begun = true;
    return is_first && own->item < own->end;
}
#endif

#endif
