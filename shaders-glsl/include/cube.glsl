// Cubes of square faces seen from inside: the texels that a direction samples, seamlessly.
//
// Faces are +x -x +y -y +z -z; u runs right and v down in [-1, 1]: (1,-v,-u) (-1,-v,u) (u,1,v) (u,-1,-v) (u,-v,1)
// (-u,-v,-1). Texel (x, y) of face f is number (f size + y) size + x.

uint cube_face(vec3 d) {
    vec3 a = abs(d);
    bool x = a.x >= a.y && a.x >= a.z, y = a.y >= a.z;
    float major = x ? d.x : y ? d.y : d.z;
    return (x ? 0u : y ? 2u : 4u) + (major < 0.0 ? 1u : 0u);
}

float face_sign(uint f) { return (f & 1u) != 0u ? -1.0 : 1.0; }

// Along a face's normal.
float face_depth(vec3 d, uint f) { return face_sign(f) * (f < 2u ? d.x : f < 4u ? d.y : d.z); }

// Along its u and v.
vec2 on_face(vec3 d, uint f) {
    float s = face_sign(f);
    return f < 2u ? vec2(-s * d.z, -d.y) : f < 4u ? vec2(d.x, s * d.z) : vec2(s * d.x, -d.y);
}

// The vector that lies so far along u, v and the normal.
vec3 from_face(uint f, float u, float v, float n) {
    float s = face_sign(f);
    return f < 2u ? vec3(s * n, -v, -s * u) : f < 4u ? vec3(u, s * n, s * v) : vec3(s * u, -v, s * n);
}

// Number of the texel at `at` of a face, or, one step past an edge, of the next face's texel there. Past a corner there is
// none: some texel of the cube. In units of half texels everything is an integer.
uint texel_across(uint f, ivec2 at, int size) {
    ivec2 c = 2 * at + 1 - size;
    bool past = max(abs(c.x), abs(c.y)) > size;
    c = clamp(c, ivec2(-size), ivec2(size));
    vec3 p = from_face(f, float(c.x), float(c.y), float(past ? size - 1 : size));
    uint g = cube_face(p);
    ivec2 i = clamp((ivec2(on_face(p, g)) + size - 1) / 2, ivec2(0), ivec2(size - 1));
    return (g * uint(size) + uint(i.y)) * uint(size) + uint(i.x);
}

// Four texels around a direction, as `corner` tells them one by one.
struct Footprint {
    uint face;
    int size;
    ivec2 first; // may be -1: past an edge
    vec2 part;   // how far towards the second column and row
    float spare; // each texel's share of the one that a corner lacks
};

Footprint cube_footprint(vec3 d, uint size) {
    Footprint r;
    r.face = cube_face(d);
    r.size = int(size);
    vec2 uv = clamp(on_face(d, r.face) / max(face_depth(d, r.face), 1e-30), vec2(-1.0), vec2(1.0));
    vec2 x = (0.5 * uv + 0.5) * float(size) - 0.5;
    vec2 low = floor(x);
    r.first = ivec2(low);
    r.part = x - low;
    bvec2 before = lessThan(r.first, ivec2(0)), after = greaterThanEqual(r.first, ivec2(r.size - 1));
    vec2 outside = vec2(before.x ? 1.0 - r.part.x : after.x ? r.part.x : 0.0,
                        before.y ? 1.0 - r.part.y : after.y ? r.part.y : 0.0);
    r.spare = outside.x * outside.y / 3.0;
    return r;
}

// Texel and weight of corner 0 to 3. Weights add up to one; the texel that a corner of the cube lacks has none, and its
// share goes to the other three.
uint corner(Footprint r, uint c, out float weight) {
    ivec2 step = ivec2(c & 1u, c >> 1u), at = r.first + step;
    vec2 w = vec2(step.x != 0 ? r.part.x : 1.0 - r.part.x, step.y != 0 ? r.part.y : 1.0 - r.part.y);
    bool lacks = (at.x < 0 || at.x >= r.size) && (at.y < 0 || at.y >= r.size);
    weight = lacks ? 0.0 : w.x * w.y + r.spare;
    return texel_across(r.face, at, r.size);
}
