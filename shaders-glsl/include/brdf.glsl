// Reflection of light from one direction: Lambert, and GGX with height-correlated Smith masking and Schlick's Fresnel
// term (Walter et al. 2007; Heitz 2014; Schlick 1994), written without cancellation.
//
// The Fresnel term is factored out: radiance is F0 (S0 - S1) + F90 S1 with two sums over the lights, one plain and one
// with (1 - l.h)^5, and the Lambert term is albedo / pi times their irradiance, so that a pixel combines colors once.

const float PI = 3.14159265358979;
// Smallest alpha = roughness^2. Below it the half vector's rounding, 1e-7, would show in the highlight.
const float ALPHA_MIN = 1e-3;
// Smallest n.v, for surfaces seen edge-on or from behind.
const float NV_MIN = 1e-4;
const vec3 LUMINANCE = vec3(0.212671, 0.715160, 0.072169);

// A pixel's surface, with what does not depend on the light.
struct Surface {
    vec3 point;
    vec3 normal;
    vec3 view;       // unit, to the camera; zero if the camera is in the point
    float facing;    // n.v
    float nv;        // n.v, at least NV_MIN
    float roughness;
    float a;         // alpha^2 = roughness^4, not below ALPHA_MIN^2
    float root_v;    // sqrt(a + nv^2 (1 - a))
};

Surface surface(vec3 point, vec3 normal, float roughness, vec3 camera) {
    Surface s;
    s.point = point;
    s.normal = normal;
    vec3 to_camera = camera - point;
    s.view = to_camera * inversesqrt(max(dot(to_camera, to_camera), 1e-30));
    s.facing = dot(normal, s.view);
    s.nv = max(s.facing, NV_MIN);
    s.roughness = roughness;
    float alpha = max(roughness * roughness, ALPHA_MIN);
    s.a = alpha * alpha;
    s.root_v = sqrt(s.a + s.nv * s.nv * (1.0 - s.a));
    return s;
}

// A surface in the light of one direction `l` with n.l > 0.
struct Lit {
    float nl;
    float specular; // D V: the specular term without Fresnel's factor
    float fresnel;  // (1 - l.h)^5
    float lh;       // l.h = v.h
    float nh;
    float inverse;  // 1 / |l + v|
    vec3 slope;     // n - (n.h) h, the part of n across h: short where the highlight is
    float t;        // 1 - (1 - a)(n.h)^2 = a (n.h)^2 + |n x h|^2
    float across;   // |n x h|^2
    float root_l;   // sqrt(a + nl^2 (1 - a))
    float q;        // nv root_l + nl root_v; V = 1 / (2 q)
};

Lit lit_by(Surface s, vec3 l, float nl) {
    Lit r;
    r.nl = nl;
    vec3 sum = l + s.view;
    float square = dot(sum, sum);
    r.inverse = inversesqrt(max(square, 1e-16));
    r.lh = 0.5 * square * r.inverse;
    r.nh = (nl + s.facing) * r.inverse;
    r.slope = s.normal - (r.nh * r.inverse) * sum;
    r.across = dot(r.slope, r.slope);
    r.t = max(s.a * r.nh * r.nh + r.across, 1e-7); // less only without a normal, which no light faces
    r.root_l = sqrt(s.a + nl * nl * (1.0 - s.a));
    r.q = s.nv * r.root_l + nl * s.root_v;
    r.specular = s.a / (2.0 * PI * r.t * r.t * r.q);
    float m = 1.0 - min(r.lh, 1.0);
    r.fresnel = m * m * m * m * m;
    return r;
}

// d ln(D V) / d ln(alpha^2); times 4 / roughness it is the derivative by roughness.
float by_alpha(Surface s, Lit r) {
    float d = (r.across - s.a * r.nh * r.nh) / r.t;
    float v = s.nv * (1.0 - r.nl * r.nl) / r.root_l + r.nl * (1.0 - s.nv * s.nv) / s.root_v;
    return d - 0.5 * s.a * v / r.q;
}

// d ln(alpha^2) / d roughness.
float alpha_by_roughness(Surface s) { return s.roughness * s.roughness > ALPHA_MIN ? 4.0 / s.roughness : 0.0; }

// Reflectance at normal and at grazing incidence.
vec3 fresnel0(vec3 albedo, float metallic) { return mix(vec3(0.04), albedo, metallic); }
float fresnel90(vec3 f0) { return min(25.0 * dot(f0, LUMINANCE), 1.0); }
