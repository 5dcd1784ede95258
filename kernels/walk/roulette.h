/* Russian roulette on paths. */
#ifndef CLOUDTOMO_ROULETTE_H
#define CLOUDTOMO_ROULETTE_H

/* Paths of smaller throughput go on with the probability throughput / PATH_ROULETTE_THROUGHPUT. */
#define PATH_ROULETTE_THROUGHPUT 0.1f

/* The throughput with which a path goes on; 0 if it ends. */
inline float after_roulette(float throughput, float u, Tally *tally)
{
    if (throughput >= PATH_ROULETTE_THROUGHPUT)
        return throughput;
    const bool survives = u * PATH_ROULETTE_THROUGHPUT < throughput;
    on_roulette(throughput, PATH_ROULETTE_THROUGHPUT, survives, tally);
    if (survives)
        return PATH_ROULETTE_THROUGHPUT;
    on_termination(TERMINATION_KILLED, throughput, tally);
    return 0.0f;
}

#endif
