// Lights as mixtures of spherical Gaussians (Wang et al. 2009, in the form exp(lambda (cos - 1))), as prepared for
// shading. Needs a constant LOBES.
//
// A light is 1 + 2 LOBES vectors: its position and squared reach; for each lobe its axis times root and the root, and its
// amplitude. With root^2 = lambda log2(e) / 2 a lobe is amplitude * 2^-|root w - root b|^2: a square that cannot cancel,
// however sharp.

// Nearer lights count as if they were this far away, squared.
const float NEAR_SQUARED = 1e-3;
// 2 ln 2: lambda = NATURAL root^2.
const float NATURAL = 1.38629436112;

uint light_at(uint light) { return light * (1u + 2u * LOBES); }

// One lobe of a light.
struct Lobe {
    vec4 axis; // times root; root
    vec3 amplitude;
};

// Direction and distance of a light from a point.
struct Ray {
    vec3 l;        // unit, towards the light; zero for a light in the point itself
    float square;  // distance squared
    float inverse; // 1 / distance
};

Ray ray_to(vec3 place, vec3 point) {
    Ray r;
    vec3 d = place - point;
    r.square = dot(d, d);
    r.inverse = inversesqrt(max(r.square, 1e-30));
    r.l = d * r.inverse;
    return r;
}

float falloff(Ray r) { return 1.0 / max(r.square, NEAR_SQUARED); }
