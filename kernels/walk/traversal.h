/* A template for functions that fly freely along a ray and do something on the way; every including file makes one,
 * so there is no include guard. It takes these macros, and undefines them:
 *
 *   TRAVERSAL            the function's name
 *   TRAVERSAL_CONTEXT    its last parameters, each after a comma; may be empty. CROSSES can use them, and the
 *                        function's local variables: their names must differ
 *   CROSSES(index, length)   statement for each crossing of `length` km of the voxel `index`, up to a collision
 *
 * It crosses a cube of empty blocks in one step (walk_skip), without CROSSES.
 *
 * The function flies along the ray up to the optical depth `optical_depth` (a collision), or until it has left
 * everything that scatters; it moves the ray there.
 */
LARGE_FUNCTION Flight TRAVERSAL(const Medium *medium, Ray *ray, float optical_depth TRAVERSAL_CONTEXT)
{
    const __constant Scene *scene = medium->scene;
    Flight flight = {false, false, false, false, 0.0f, 0.0f, 0.0f, -1};
    bool beside_empty = false; /* skipping may begin: the voxel before, or the grid's surroundings, are empty */
    if (!ray->inside) {
        Ray entered = *ray;
        float distance;
        flight.met_grid = enter_domain(scene, &entered, &distance);
        if (fly_outside(medium, ray, optical_depth, flight.met_grid ? distance : INFINITY, &flight))
            return flight;
        if (!flight.met_grid)
            return flight;
        *ray = entered;
        beside_empty = scene->skips_empty;
    }
    flight.met_grid = true;
    VoxelWalk walk = walk_begin(scene, ray);
    for (int crossing = 0; crossing < CROSSINGS_LIMIT; ++crossing) {
        bool goes_on;
        const int empty = beside_empty ? medium->empty[empty_block(scene, &walk)] : 0;
        if (empty > (scene->empty_shift == 0)) {
            goes_on = walk_skip(scene, &walk, empty);
        } else {
            const float exit = walk_exit(&walk);
            const float length = exit - walk.distance;
            const float droplets = medium->extinction[walk.index];
            const float air = medium->air[walk_layer(scene, &walk)];
            const float extinction = droplets + air;
            const float depth = flight.depth + extinction * length;
            if (depth >= optical_depth) {
                const float part = lesser((optical_depth - flight.depth) / extinction, length);
                CROSSES(walk.index, part);
                move_to_walk(scene, ray, &walk, walk.distance + part);
                flight.collided = true;
                flight.depth = optical_depth;
                flight.droplets = droplets;
                flight.air = air;
                flight.index = walk.index;
                return flight;
            }
            CROSSES(walk.index, length);
            flight.depth = depth;
            beside_empty = extinction == 0.0f && scene->skips_empty;
            goes_on = walk_advance(scene, &walk, exit);
        }
        if (!goes_on) {
            ray->position += walk.distance * ray->direction / grid_spacing(scene);
            ray->inside = false;
            flight.through_side = walk.ahead_z >= 0;
            fly_outside(medium, ray, optical_depth, INFINITY, &flight);
            return flight;
        }
    }
    flight.lost = true;
    ray->inside = false;
    return flight;
}

#undef TRAVERSAL
#undef TRAVERSAL_CONTEXT
#undef CROSSES
