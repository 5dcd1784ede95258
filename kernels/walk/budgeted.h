/* For tallies with an energy budget: a path's own in `budget`, and those of all paths in `sums`. They say themselves
 * what an absorption is. */
#ifndef CLOUDTOMO_BUDGETED_H
#define CLOUDTOMO_BUDGETED_H

#include "walk/budget.h"
#include "walk/event.h"

inline void on_roulette(float throughput, float raised, bool survives, Tally *tally)
{
    budget_roulette(tally->budget, throughput, raised, survives);
}

inline void on_termination(Termination termination, float throughput, Tally *tally)
{
    budget_termination(termination, throughput, tally->sums);
}

inline void on_branch(float given, float taken, Tally *tally) { budget_branch(tally->budget, given, taken); }

#endif
