/* The near field of a Jacobian: the voxels around a pixel's line of sight.
 *
 * A pixel's tile has TILE_WIDTH x TILE_WIDTH voxels around the line in every slab, a layer of voxels across the axis
 * along which the line crosses most voxels. A voxel's slot, its number in the tile, follows from its position. Voxels
 * that are not in the tile belong to the far field. */
#ifndef CLOUDTOMO_NEAR_FIELD_H
#define CLOUDTOMO_NEAR_FIELD_H

#define TILE_AREA (TILE_WIDTH * TILE_WIDTH)

inline int component(int3 a, int axis) { return axis == 0 ? a.x : axis == 1 ? a.y : a.z; }

/* The first voxel of the tile in a slab, along one of the other two axes (0, 1). */
inline int tile_corner(const __global Tile *tile, int slab, int across)
{
    return (int)floor(tile->centre[across] + (float)slab * tile->slope[across]) - TILE_WIDTH / 2;
}

/* The offset from one voxel to another, modulo the count where the domain repeats itself: from 0 to below it. */
inline int wrapped_offset(int offset, int count, bool wraps)
{
    if (!wraps)
        return offset;
    const int rest = offset % count;
    return rest < 0 ? rest + count : rest;
}

/* A voxel's slot in a tile, or -1. */
inline int tile_slot(const __constant Scene *scene, const __global Tile *tile, int3 voxel)
{
    const int axis = tile->axis, slab = component(voxel, axis) - tile->first_slab;
    if (slab < 0 || slab >= tile->slabs)
        return -1;
    const int first = (axis + 1) % 3, second = (axis + 2) % 3;
    const int at = slab + tile->first_slab;
    const bool periodic = scene->periodic;
    const int u =
        wrapped_offset(component(voxel, first) - tile_corner(tile, at, 0), scene->shape[first], periodic && first < 2);
    const int v = wrapped_offset(component(voxel, second) - tile_corner(tile, at, 1), scene->shape[second],
                                 periodic && second < 2);
    if (u < 0 || u >= TILE_WIDTH || v < 0 || v >= TILE_WIDTH)
        return -1;
    return (slab * TILE_WIDTH + u) * TILE_WIDTH + v;
}

/* The index of the voxel in a slot, in arrays [x][y][z]; -1 if it is outside of the grid. */
inline int slot_index(const __constant Scene *scene, const __global Tile *tile, int slot)
{
    const int axis = tile->axis, first = (axis + 1) % 3, second = (axis + 2) % 3;
    const int at = slot / TILE_AREA + tile->first_slab;
    int place[3];
    place[axis] = at;
    place[first] = tile_corner(tile, at, 0) + slot / TILE_WIDTH % TILE_WIDTH;
    place[second] = tile_corner(tile, at, 1) + slot % TILE_WIDTH;
    for (int n = 0; n < 3; ++n) {
        if (scene->periodic && n < 2 && n != axis)
            place[n] = wrapped_offset(place[n], scene->shape[n], true);
        if (place[n] < 0 || place[n] >= scene->shape[n])
            return -1;
    }
    return (place[0] * scene->shape[1] + place[1]) * scene->shape[2] + place[2];
}

#endif
