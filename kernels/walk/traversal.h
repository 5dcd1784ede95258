/* A free flight along a ray, and what is done on its way: a template, which every file that includes it makes
 * a function of (so there is no include guard). It takes, and undefines:
 *
 *   TRAVERSAL            the function's name
 *   TRAVERSAL_CONTEXT    its last parameters, each after a comma; may be empty. What is done sees them, and the
 *                        function's own variables: their names must differ
 *   CROSSES(index, length)   done when it crosses `length` km of the voxel `index`, up to a collision
 *
 * Through a cube of empty blocks it goes in one step (walk_skip), which crosses nothing.
 *
 * The function flies along the ray until it has crossed the optical depth `optical_depth` (a collision) or left all
 * that scatters; it moves the ray there.
 */
LARGE_FUNCTION Flight TRAVERSAL(const Medium *medium, Ray *ray, float optical_depth TRAVERSAL_CONTEXT)
{
    const __constant Scene *scene = medium->scene;
    Flight flight = {false, false, false, false, 0.0f, 0.0f, 0.0f, -1};
    bool beside_empty = false; /* skipping may begin here: the voxel before, or what is around the grid, is empty */
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
