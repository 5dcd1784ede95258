/* For tallies without an energy budget, for instance replayed paths, which the audit has checked before. */
#ifndef CLOUDTOMO_UNBUDGETED_H
#define CLOUDTOMO_UNBUDGETED_H

#include "walk/event.h"

inline void on_absorption(const Medium *medium, const KEPT Interaction *at, float weight, Tally *tally) {}
inline void on_roulette(float throughput, float raised, bool survives, Tally *tally) {}
inline void on_termination(Termination termination, float throughput, Tally *tally) {}
inline void on_branch(float given, float taken, Tally *tally) {}

#endif
