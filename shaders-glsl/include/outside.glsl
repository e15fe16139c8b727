// Light from outside of a room: openings, and the environment behind them. Include area_light.glsl and angle.glsl before.
// The push constants have `offset`, `openings`, `sky_columns` and `sky_rows`.

IN(LightRecord, openings); // rectangles; their normals point into the room
IN(float, sky);            // [sky_rows * sky_columns * 3] radiance; the layout of latitude-longitude files

// Distance along a unit direction at which a ray leaves the room, or -1. Openings reach push.offset past their edges.
float opening_distance(vec3 point, vec3 direction) {
    float nearest = -1.0;
    [[dont_unroll]] for (uint k = 0u; k < push.openings; k++) {
        LightRecord o = openings[k];
        vec3 to = o.origin - point;
        float facing = dot(o.normal, direction), t = dot(o.normal, to) / facing;
        // False for openings without an area and for rays along them.
        if (!(facing < -1e-6) || !(t > 0.0)) continue;
        vec3 place = t * direction - to;
        vec2 square = vec2(dot(o.axis, o.axis), dot(o.side, o.side));
        vec2 at = vec2(dot(place, o.axis), dot(place, o.side)) / square, margin = push.offset * inversesqrt(square);
        bool inside = all(greaterThanEqual(at, -margin)) && all(lessThanEqual(at, 1.0 + margin));
        if (inside && (nearest < 0.0 || t < nearest)) nearest = t;
    }
    return nearest;
}

// Radiance of a channel that arrives from a direction of any length, bilinear.
float sky_radiance(vec3 direction, uint channel) {
    float theta = angle_of(length(direction.xz), direction.y), phi = angle_of(direction.x, -direction.z);
    uvec2 size = uvec2(push.sky_columns, push.sky_rows);
    float x = (phi * 0.159154943092 + 0.5) * float(size.x) - 0.5;
    float y = clamp(theta * 0.318309886184 * float(size.y) - 0.5, 0.0, float(size.y - 1u));
    float column = floor(x), row = floor(y);
    // The map wraps around; its first and last rows extend to the poles.
    uvec2 across, down;
    across.x = min(uint(column < 0.0 ? column + float(size.x) : column), size.x - 1u);
    across.y = across.x + 1u < size.x ? across.x + 1u : 0u;
    down.x = min(uint(row), size.y - 1u);
    down.y = min(down.x + 1u, size.y - 1u);
    uvec2 start = 3u * size.x * down + channel;
    vec2 low = vec2(sky[start.x + 3u * across.x], sky[start.y + 3u * across.x]);
    vec2 high = vec2(sky[start.x + 3u * across.y], sky[start.y + 3u * across.y]);
    // Exact where the map is constant.
    vec2 rows = low + (x - column) * (high - low);
    return rows.x + (y - row) * (rows.y - rows.x);
}
