// Projection of a Gaussian to a splat of one camera. Included after distortion.glsl and splat.glsl.

const float DILATION = 0.3;         // px² added to the projected covariance
const float JACOBIAN_LIMIT = 1.3;   // of half the field of view, from the image center

// Whether the 2D Mip filter scales opacities (Yu et al. 2024, Mip-Splatting): where dilation makes a footprint larger, the splat fades.
layout(constant_id = 38) const bool MIP_FILTER = false;

// x/z and y/z clamped to 1.3 half fields of view of the image center, where the linearization is still good.
vec2 clamped_slope(Camera c, vec2 slope, out bvec2 clamped) {
    vec2 half_view = 0.5 * vec2(c.size) / c.focal;
    vec2 middle = (0.5 * vec2(c.size) - c.center) / c.focal;
    vec2 low = middle - JACOBIAN_LIMIT * half_view;
    vec2 high = middle + JACOBIAN_LIMIT * half_view;
    clamped = bvec2(slope.x < low.x || slope.x > high.x, slope.y < low.y || slope.y > high.y);
    return clamp(slope, low, high);
}

// What projection computes on the way, for the backward pass.
struct Projection {
    vec3 point;      // camera space
    vec2 slope;      // clamped x/z, y/z
    bvec2 clamped;      // true where the slope was clamped
    vec3 t0;         // rows of J W R S, with the distortion in J
    vec3 t1;
    vec3 scale;
    vec4 rotation;   // unit
    float inverse_norm;
    vec3 covariance; // a, b, c with dilation
    float determinant;
    float determinant0; // without dilation
    float opacity;      // without the filter
    Splat splat;
};

// False if the splat cannot be visible: behind the near plane, too faint, or with a non-finite place, scale or opacity.
bool project_splat(Camera camera, vec3 mean, vec3 log_scale, vec4 quaternion, float opacity_logit, out Projection o) {
    // Before any comparison or clamp, whose result for a NaN is undefined.
    if (!finite_bits(mean) || !finite_bits(log_scale) || !finite_bits(opacity_logit)) return false;
    o.point = to_camera(camera, mean);
    o.opacity = 1.0 / (1.0 + exp(-opacity_logit));
    float z = o.point.z;
    if (!finite_bits(z) || z < camera.near || o.opacity < ALPHA_MIN) return false;
    o.scale = exp(clamp(log_scale, LOG_SCALE_MIN, LOG_SCALE_MAX));
    o.rotation = unit_quaternion(quaternion, o.inverse_norm);
    mat3 m = quaternion_matrix(o.rotation);
    m[0] *= o.scale.x;
    m[1] *= o.scale.y;
    m[2] *= o.scale.z;
    mat3 q = camera_rotation(camera) * m; // columns are the scaled axes in camera space
    float inverse_z = 1.0 / z;
    vec2 slope = o.point.xy * inverse_z;
    o.slope = clamped_slope(camera, slope, o.clamped);
    vec2 f = camera.focal * inverse_z;
    vec3 r0 = vec3(q[0].x, q[1].x, q[2].x);
    vec3 r1 = vec3(q[0].y, q[1].y, q[2].y);
    vec3 r2 = vec3(q[0].z, q[1].z, q[2].z);
    o.t0 = f.x * (r0 - o.slope.x * r2);
    o.t1 = f.y * (r1 - o.slope.y * r2);
    vec2 offset = camera.focal * slope;
    if (DISTORTED) {
        // Beyond the limits of slopes the image goes straight on: a polynomial would fold back.
        vec2 m = camera.focal * o.slope, terms = distortion_terms(camera, m);
        vec3 along = terms.y * (m.x * o.t0 + m.y * o.t1);
        o.t0 = terms.x * o.t0 + m.x * along;
        o.t1 = terms.x * o.t1 + m.y * along;
        offset = terms.x * offset + terms.y * dot(m, offset - m) * m;
    }
    float a = dot(o.t0, o.t0), b = dot(o.t0, o.t1), c = dot(o.t1, o.t1);
    // Sum of squared minors instead of a*c - b*b: nothing cancels.
    vec3 minors = cross(o.t0, o.t1);
    o.determinant0 = dot(minors, minors);
    o.determinant = o.determinant0 + DILATION * (a + c) + DILATION * DILATION;
    o.covariance = vec3(a + DILATION, b, c + DILATION);
    o.splat.mean = offset + camera.center;
    float root = inversesqrt(o.covariance.z);
    float root_det = inversesqrt(o.determinant);
    o.splat.factor =
        FACTOR_SCALE * vec3(o.covariance.z * root * root_det, -b * root * root_det, root);
    // The filter keeps the opacity summed over the image: dilation enlarges the footprint.
    o.splat.opacity = MIP_FILTER ? o.opacity * sqrt(o.determinant0 / o.determinant) : o.opacity;
    if (MIP_FILTER && !(o.splat.opacity >= ALPHA_MIN)) return false;
    return finite_bits(o.determinant) && finite_bits(o.splat.mean.x) && finite_bits(o.splat.mean.y) &&
           o.splat.factor.x > 0.0 && o.splat.factor.z > 0.0;
}
