/* The medium: droplets and molecules, their phase functions, the surface, the sun. */
#ifndef CLOUDTOMO_MEDIUM_H
#define CLOUDTOMO_MEDIUM_H

#include "walk/grid.h"
#include "walk/phase.h"

typedef struct {
    const __constant Scene *scene;
    const __global float *extinction; /* extinction of droplets, km^-1, [x][y][z] */
    const __global float *table_row;  /* [voxel]: row of the phase table, or a place between two rows */
    const __global uchar *empty;      /* [block]: how many blocks around it hold nothing, see walk_skip */
    const __global float *air;        /* extinction of molecules in the grid's layers, km^-1, [z] */
    const __global float *level;      /* heights of the faces of all layers of air, km above the grid's lowest face */
    const __global float *layer;      /* extinction of molecules in all layers of air, km^-1 */
    const __global float *albedo;     /* single-scattering albedo of the phase table's rows */
    PhaseTable table;
} Medium;

/* `profiles` holds, one after the other: the layers' faces and extinctions, and the phase table's
 * nodes, densities, cumulative shares and albedos. */
inline Medium make_medium(MEDIUM_PARAMETERS)
{
    Medium medium;
    medium.scene = scene;
    medium.extinction = extinction;
    medium.table_row = table_row;
    medium.empty = empty;
    medium.level = profiles;
    medium.layer = medium.level + scene->air_layers + 1;
    medium.air = medium.layer + scene->air_layers_below;
    medium.table.nodes = scene->table_nodes;
    medium.table.node = medium.layer + scene->air_layers;
    medium.table.density = medium.table.node + scene->table_nodes;
    medium.table.cumulative = medium.table.density + scene->table_rows * scene->table_nodes;
    medium.albedo = medium.table.cumulative + scene->table_rows * scene->table_nodes;
    return medium;
}

/* The number of a droplet is its row of the phase table (0 without a table); others have negative numbers. */
typedef int Particle;
#define PARTICLE_MOLECULE (-1)
#define PARTICLE_SURFACE (-2)
#define PARTICLE_NONE (-3)

inline float3 sun_direction(const __constant Scene *scene)
{
    return (float3)(scene->sun[0], scene->sun[1], scene->sun[2]);
}

#ifdef CLOUDTOMO_PHASE_TABLE
/* The density (sr^-1) of scattering from direction `from` into `to` by a droplet. */
inline float droplet_density(const Medium *medium, int row, float3 from, float3 to)
{
    const float3 turn = to - from;
    return table_density(&medium->table, row, 0.25f * scalar_product(turn, turn));
}

/* The cosine of a sampled scattering angle of a droplet. */
inline float sample_droplet(const Medium *medium, int row, float u) { return sample_table(&medium->table, row, u); }

/* Chooses the row of a droplet in a voxel, and gives its single-scattering albedo. Droplets between two rows of
 * the phase table are a mixture of both. */
inline Particle choose_droplet(const Medium *medium, int index, float u_row, float *albedo)
{
    int row = 0;
    if (medium->scene->table_rows > 1) {
        const float between = medium->table_row[index];
        row = (int)between;
        row += u_row < between - (float)row;
    }
    *albedo = medium->albedo[row];
    return row;
}
#else
inline float droplet_density(const Medium *medium, int row, float3 from, float3 to)
{
    const __constant Scene *scene = medium->scene;
    return double_henyey_greenstein(scalar_product(from, to), scene->forward_g, scene->backward_g,
                                    scene->forward_fraction);
}

inline float sample_droplet(const Medium *medium, int row, float u)
{
    const __constant Scene *scene = medium->scene;
    return sample_double_henyey_greenstein(u, scene->forward_g, scene->backward_g, scene->forward_fraction);
}

inline Particle choose_droplet(const Medium *medium, int index, float u_row, float *albedo)
{
    *albedo = medium->scene->droplet_albedo;
    return 0;
}
#endif

/* The density (sr^-1) of scattering from direction `from` into `to`; for a Lambertian
 * surface, the density of its reflection. */
inline float scatter_density(const Medium *medium, Particle particle, float3 from, float3 to)
{
    switch (particle) {
    case PARTICLE_MOLECULE: return rayleigh(scalar_product(from, to));
    case PARTICLE_SURFACE: return greater(to.z, 0.0f) * ONE_OVER_PI;
    default: return droplet_density(medium, particle, from, to);
    }
}

inline float3 sample_scatter(const Medium *medium, Particle particle, float3 from, float2 u)
{
    switch (particle) {
    case PARTICLE_MOLECULE: return direction_around(from, sample_rayleigh(u.x), u.y);
    case PARTICLE_SURFACE: return direction_around((float3)(0.0f, 0.0f, 1.0f), square_root(u.x), u.y);
    default: return direction_around(from, sample_droplet(medium, particle, u.x), u.y);
    }
}

/* The density (sr^-1) of directions drawn around the sun: the droplets' phase function, its middle row. */
inline float sun_density(const Medium *medium, float3 to)
{
    return droplet_density(medium, medium->scene->table_rows / 2, sun_direction(medium->scene), to);
}

inline float3 sample_around_sun(const Medium *medium, float2 u)
{
    return direction_around(sun_direction(medium->scene), sample_droplet(medium, medium->scene->table_rows / 2, u.x),
                            u.y);
}

/* Which particle a collision is with, and its single-scattering albedo. */
inline Particle choose_particle(const Medium *medium, float droplets, float air, int index, float u, float u_row,
                                float *albedo)
{
    if (u * (droplets + air) >= droplets) {
        *albedo = medium->scene->air_albedo;
        return PARTICLE_MOLECULE;
    }
    return choose_droplet(medium, index, u_row, albedo);
}

#endif
