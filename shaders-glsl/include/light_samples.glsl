// Sample points on physical lights, for shadow rays. Include light_irradiance.glsl and random.glsl before.
//
// The set is Hammersley's, with a power of two of points, shifted by a hash of receiver and light (Cranley and Patterson
// 1976). Spheres and directional lights: uniform in the cone that they subtend. Rectangles and disks: uniform in area.

// Distance of directional lights.
const float LIGHT_FAR = 1e15;

struct LightSample {
    vec3 to;      // from the receiver
    float weight; // share of the irradiance, up to a factor
};

// Point `s` of a set of `count`, shifted.
vec2 light_point(uint s, uint count, vec2 shift) {
    vec2 x = vec2((float(s) + 0.5) / float(count), float(bitfieldReverse(s) >> 8u) * (1.0 / 16777216.0));
    return fract(x + shift);
}

vec2 light_shift(uint seed, uint receiver, uint light) {
    return vec2(uniform_from(random_bits(seed, receiver, 2u * light)), uniform_from(random_bits(seed, receiver, 2u * light + 1u)));
}

// A vector of an orthonormal basis around a unit vector, in coordinates (Duff et al. 2017).
vec3 around(vec3 axis, vec3 x) {
    float z = axis.z >= 0.0 ? 1.0 : -1.0, a = -1.0 / (z + axis.z), b = axis.x * axis.y * a;
    return x.x * vec3(1.0 + z * axis.x * axis.x * a, z * b, -z * axis.x) +
           x.y * vec3(b, z + axis.y * axis.y * a, -axis.y) + x.z * axis;
}

// A direction in the cone around a unit axis, and 1 minus its cosine.
vec4 cone_sample(vec3 axis, float s, vec2 x) {
    // 1 - cos of the half angle.
    float open = s * s / (1.0 + sqrt((1.0 - s) * (1.0 + s)));
    float down = x.x * open, sine = sqrt(down * (2.0 - down)), phi = 2.0 * LIGHT_PI * x.y;
    return vec4(around(axis, vec3(sine * cos(phi), sine * sin(phi), 1.0 - down)), down);
}

// Distance at which a unit direction meets the sphere around `center`, from outside; `down` is 1 - cos of the angle between them.
float sphere_distance(float distance, float radius, float down) {
    float c = 1.0 - down, across = distance * distance * down * (2.0 - down);
    float half_chord = sqrt(max(radius * radius - across, 0.0));
    return (distance - radius) * (distance + radius) / (distance * c + half_chord);
}

LightSample light_sample(LightRecord light, vec3 point, vec3 normal, vec2 x) {
    LightSample r;
    if (light.kind == LIGHT_DIRECTIONAL) {
        vec3 l = cone_sample(light.origin, light.radius, x).xyz;
        return LightSample(LIGHT_FAR * l, max(dot(normal, l), 0.0));
    }
    vec3 to = light.origin - point;
    if (light.kind == LIGHT_SPHERE) {
        float square = dot(to, to), distance = sqrt(square);
        if (light.radius >= distance) {
            // Inside: cosine-distributed over the hemisphere, to the sphere around.
            float phi = 2.0 * LIGHT_PI * x.y;
            vec3 l = around(normal, vec3(sqrt(x.x) * vec2(cos(phi), sin(phi)), sqrt(1.0 - x.x)));
            float near = dot(l, to);
            float reach = near + sqrt(max(near * near + (light.radius - distance) * (light.radius + distance), 0.0));
            return LightSample(reach * l, 1.0);
        }
        vec4 l = cone_sample(to / distance, light.radius / distance, x);
        return LightSample(sphere_distance(distance, light.radius, l.w) * l.xyz, max(dot(normal, l.xyz), 0.0));
    }
    vec2 place = x;
    if (light.kind == LIGHT_DISK) {
        float phi = 2.0 * LIGHT_PI * x.y;
        place = light.radius * sqrt(x.x) * vec2(cos(phi), sin(phi));
    }
    // Points, spots and lobes are not sampled.
    to += place.x * light.axis + place.y * light.side;
    return LightSample(to, light_geometry(to, normal, light.normal));
}

// The highest point of the light above the horizon, for receivers whose samples are all below.
vec3 light_top(LightRecord light, vec3 point, vec3 normal) {
    vec3 to = light.origin - point;
    if (light.kind == LIGHT_RECTANGLE || light.kind == LIGHT_WINDOW) {
        return to + step(0.0, dot(normal, light.axis)) * light.axis + step(0.0, dot(normal, light.side)) * light.side;
    }
    if (light.kind == LIGHT_DISK) {
        vec3 up = dot(normal, light.axis) * light.axis + dot(normal, light.side) * light.side;
        return to + light.radius * inversesqrt(max(dot(up, up), 1e-30)) * up;
    }
    vec3 axis = light.origin;
    float s = light.radius, distance = 1.0;
    if (light.kind == LIGHT_SPHERE) {
        distance = length(to);
        axis = to / distance;
        s /= distance;
    }
    vec3 up = normal - dot(normal, axis) * axis;
    float c = sqrt(max((1.0 - s) * (1.0 + s), 0.0));
    vec3 l = c * axis + s * inversesqrt(max(dot(up, up), 1e-30)) * up;
    return (light.kind == LIGHT_SPHERE ? distance * c : LIGHT_FAR) * l;
}
