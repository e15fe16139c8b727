// Irradiance of a receiver from a physical light of color 1, without occluders. Include area_light.glsl before.
//
// Closed forms with the horizon: points, spots and lobes by the inverse square law (KHR_lights_punctual); rectangles by Lambert's
// polygon formula; disks by the same integral along the rim; spheres and directional lights by the cone that they subtend.
// Lights that are small from the receiver use four points instead, because the closed forms cancel there.

#include "angle.glsl"

const float LIGHT_PI = 3.14159265358979;
// Nearer points, spots and lobes count as if they were this far away, squared.
const float LIGHT_NEAR_SQUARED = 1e-3;
// Size over distance, squared, below which four points replace closed forms: above the horizon, and across it.
const float LIGHT_SMALL = 2.5e-3, LIGHT_SMALL_CUT = 1e-6;

// Geometric term of a point of a rectangle or disk at `to` from the receiver, per area.
float light_geometry(vec3 to, vec3 normal, vec3 light_normal) {
    float square = max(dot(to, to), 1e-18);
    return max(dot(normal, to), 0.0) * max(-dot(light_normal, to), 0.0) / (square * square);
}

// Cone of directions around a unit axis, by the sine of its half angle, below 1. `cosine`: of the axis and the normal.
float cone_irradiance(float cosine, float s) {
    if (cosine >= s) return LIGHT_PI * s * s * cosine;
    if (cosine <= -s) return 0.0;
    if (s < 5e-3) {
        // A flat disk.
        float t = cosine / s, w = sqrt(max((1.0 - t) * (1.0 + t), 0.0));
        return s * s * s * (t * (LIGHT_PI - angle_of(w, t) + t * w) + (2.0 / 3.0) * w * w * w);
    }
    // Snyder 1996, Area light sources for real-time graphics.
    float x = sqrt((1.0 - s) * (1.0 + s)) / s, sine = sqrt((1.0 - cosine) * (1.0 + cosine));
    float y = clamp(-x * cosine / sine, -1.0, 1.0), root = sqrt((1.0 - y) * (1.0 + y)), w = sine * root;
    return max(s * s * (cosine * angle_of(root, y) - x * w) + angle_of(w, x), 0.0);
}

// Part from a to b (as shares of the edge) of the contour integral along an edge.
float edge_integral(vec3 start, vec3 edge, vec2 part, vec3 normal) {
    vec3 turn = cross(start, edge);
    float size = length(turn);
    float angle = angle_of((part.y - part.x) * size, dot(start + part.x * edge, start + part.y * edge));
    return size > 0.0 ? angle * dot(normal, turn) / size : 0.0;
}

// Part of the contour integral along the horizon, from a point by a step. (Points and their difference are separate because
// distant points are close to each other.)
float horizon_integral(vec3 from, vec3 step, vec3 normal) {
    return angle_of(dot(normal, cross(from, step)), dot(from, from + step));
}

// `corner`: from the receiver. The receiver is on the side that emits.
float rectangle_irradiance(vec3 corner, LightRecord light, vec3 normal) {
    vec3 center = corner + 0.5 * (light.axis + light.side);
    float square = dot(center, center), size = dot(light.axis, light.axis) + dot(light.side, light.side);
    float height = dot(normal, center), half_height = 0.5 * (abs(dot(normal, light.axis)) + abs(dot(normal, light.side)));
    if (height <= -half_height) return 0.0;
    if (size < (height >= half_height ? LIGHT_SMALL : LIGHT_SMALL_CUT) * square) {
        vec3 x = 0.288675135 * light.axis, y = 0.288675135 * light.side;
        return 0.25 * light.area *
               (light_geometry(center + x + y, normal, light.normal) + light_geometry(center + x - y, normal, light.normal) +
                light_geometry(center - x + y, normal, light.normal) + light_geometry(center - x - y, normal, light.normal));
    }
    float sum = 0.0;
    // Places on the rectangle, from its corner.
    vec3 place = vec3(0.0), sinking = vec3(0.0), rising = vec3(0.0);
    bool cut = false;
    [[unroll]] for (uint k = 0u; k < 4u; k++) {
        vec3 edge = (k & 1u) == 0u ? light.axis : light.side;
        if (k >= 2u) edge = -edge;
        vec3 next = k == 0u ? light.axis : k == 1u ? light.axis + light.side : k == 2u ? light.side : vec3(0.0);
        float a = dot(normal, corner + place), b = dot(normal, corner + next);
        if (a > 0.0 || b > 0.0) {
            float at = a / (a - b);
            vec2 part = vec2(a < 0.0 ? at : 0.0, b < 0.0 ? at : 1.0);
            sum += edge_integral(corner + place, edge, part, normal);
            if (b <= 0.0) sinking = place + part.y * edge;
            if (a <= 0.0) rising = place + part.x * edge;
            cut = cut || a <= 0.0;
        }
        place = next;
    }
    if (cut) sum += horizon_integral(corner + sinking, rising - sinking, normal);
    // The corners go around the light's normal, which points to the receiver.
    return max(-0.5 * sum, 0.0);
}

// `center`: from the receiver. The receiver is on the side that emits.
float disk_irradiance(vec3 center, LightRecord light, vec3 normal) {
    float radius = light.radius, square = dot(center, center);
    // Axes: u in the plane of the disk away from the receiver's foot, m along the disk's axis away from the receiver.
    vec3 m = -light.normal;
    float x = dot(center, light.axis), y = dot(center, light.side);
    float cu = length(vec2(x, y)), cm = dot(center, m);
    vec3 u = cu > 0.0 ? (x * light.axis + y * light.side) / cu : light.axis;
    vec3 v = cross(m, u);
    float nm = dot(normal, m), nu = dot(normal, u), nv = dot(normal, v);
    float height = dot(normal, center), across = length(vec2(nu, nv)), swing = radius * across;
    if (height <= -swing) return 0.0;
    bool whole = height >= swing;
    if (4.0 * radius * radius < (whole ? LIGHT_SMALL : LIGHT_SMALL_CUT) * square) {
        vec3 a = 0.707106781 * radius * light.axis, b = 0.707106781 * radius * light.side;
        return 0.25 * light.area *
               (light_geometry(center + a, normal, light.normal) + light_geometry(center - a, normal, light.normal) +
                light_geometry(center + b, normal, light.normal) + light_geometry(center - b, normal, light.normal));
    }
    // The squared distance of the rim is d + e cos(phi), with phi from u; s = sqrt(d^2 - e^2).
    float rise = cm * cm;
    float s = max(sqrt((rise + (cu - radius) * (cu - radius)) * (rise + (cu + radius) * (cu + radius))), 1e-30);
    float flat_square = cu * cu, g = rise + radius * radius, d = flat_square + g, e = 2.0 * radius * cu;
    if (whole) {
        float w = flat_square > g ? 4.0 * flat_square * rise / (s + flat_square - g) : s - flat_square + g;
        return max(LIGHT_PI * radius * radius / (s * (s + d)) * (nm * w + 2.0 * cu * cm * nu), 0.0);
    }
    // The part above the horizon: phi within `half_width` of that of the highest point.
    float k = -height / swing, root = sqrt(max((1.0 - k) * (1.0 + k), 0.0)), half_width = angle_of(root, k);
    vec2 top = vec2(nu, nv) / across;
    vec2 begin = vec2(top.x * k + top.y * root, top.y * k - top.x * root);
    vec2 end = vec2(top.x * k - top.y * root, top.y * k + top.x * root);
    // Integrals of cos, sin and 1 over the squared distance.
    float beta = e / (d + s);
    float before = begin.y / (1.0 + beta * begin.x), after = end.y / (1.0 + beta * end.x);
    float bend = after * atan_ratio(beta * after) - before * atan_ratio(beta * before);
    float turned = 2.0 * (half_width - beta * bend);
    float cosines = 2.0 * bend / (d + s) - e * turned / (s * (d + s));
    float step = (end.x - begin.x) / max(d + e * begin.x, 1e-30);
    float sines = -step * log_ratio(e * step);
    float arc = radius * ((cu * nm - cm * nu) * cosines - cm * nv * sines + radius * nm * turned / s);
    vec2 chord = radius * (begin - end);
    vec3 from = center + radius * (end.x * u + end.y * v);
    return max(0.5 * (arc + horizon_integral(from, chord.x * u + chord.y * v, normal)), 0.0);
}

// Irradiance of a receiver with a unit normal, or 0 if it faces away or is behind the light.
float light_irradiance(LightRecord light, vec3 point, vec3 normal) {
    if (light.kind == LIGHT_DIRECTIONAL) {
        float cosine = dot(normal, light.origin), s = light.radius;
        return s > 0.0 ? cone_irradiance(cosine, s) / (LIGHT_PI * s * s) : max(cosine, 0.0);
    }
    vec3 to = light.origin - point;
    float square = dot(to, to), inverse = inversesqrt(max(square, 1e-30));
    float cosine = dot(normal, to) * inverse;
    if (light.kind == LIGHT_SPHERE) {
        float s = light.radius * inverse;
        // Inside of the sphere, the whole hemisphere is bright.
        return s < 1.0 ? cone_irradiance(cosine, s) : LIGHT_PI;
    }
    if (light_is_point(light.kind)) {
        float share = 1.0;
        if (light.kind == LIGHT_SPOT) {
            float cone = clamp(light.bias - light.radius * dot(light.axis, to) * inverse, 0.0, 1.0);
            share = cone * cone;
        } else if (light.kind == LIGHT_LOBE) {
            // 1 - cos of the angle to the axis, without cancellation.
            vec3 apart = light.axis + inverse * to;
            share = exp(-light.radius * (0.5 * dot(apart, apart)));
        }
        return max(cosine, 0.0) * share / max(square, LIGHT_NEAR_SQUARED);
    }
    if (dot(light.normal, to) >= 0.0) return 0.0;
    return light.kind == LIGHT_DISK ? disk_irradiance(to, light, normal) : rectangle_irradiance(to, light, normal);
}
