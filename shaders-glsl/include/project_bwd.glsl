// Backward of projection for one splat: from the blending sums of its entries to gradients of its parameters.
// Included after projection.glsl and sh.glsl.

// Not zero unless `x` is: also for numbers that are not finite, which comparisons and max() may lose.
uint magnitude_bits(float x) { return floatBitsToUint(x) & 0x7fffffffu; }

struct SplatGradient {
    vec3 mean;
    vec3 log_scale;
    vec4 rotation;
    float opacity_logit;
    vec2 mean2d;        // pixels; for densification
    mat3 camera_rows;   // d/d(rotation part of world-to-camera), as rows
    vec3 camera_translation;
    vec3 lens;          // d/d(logarithm of the focal lengths), d/d(shift of the principal point in focal lengths)
    float radial;       // d/d(radial distortion)
    vec3 camera_turn;   // d/d(turn of the camera about its center, world axes), by the splat's axes alone
};

// Gradient of the projected mean, pixels, from the moments h p and h dy.
vec2 screen_gradient(Projection o, float hp, float hy) {
    float u11 = o.splat.factor.x, u12 = o.splat.factor.y, u22 = o.splat.factor.z;
    return -2.0 * vec2(u11 * hp, u12 * hp + u22 * u22 * hy);
}

// Adds the gradient of the filter's factor f = sqrt(D0 / D), with m = t0 x t1, D0 = |m|² and D = D0 + e (|t0|² + |t1|²) + e²:
//   d(log f)/dt0 = (t1 x m) (1/D0 - 1/D) - e t0/D, likewise by t1 with m x t0.
// 1/D0 - 1/D and the sums of squares below cancel nowhere. Visible splats have D0 of at least ALPHA_MIN² D.
void filter_gradient(Projection o, float by_log, inout vec3 dt0, inout vec3 dt1, inout vec3 log_scale) {
    vec3 m = cross(o.t0, o.t1);
    float inverse = 1.0 / o.determinant;
    // e (|t0|² + |t1|²) + e², from the covariance with dilation.
    float added = DILATION * (o.covariance.x + o.covariance.z - DILATION);
    float both = by_log * (added * inverse / max(o.determinant0, 1e-30)), dilated = by_log * (DILATION * inverse);
    dt0 += both * cross(o.t1, m) - dilated * o.t0;
    dt1 += both * cross(m, o.t0) - dilated * o.t1;
    vec3 squares = m * m;
    log_scale += both * vec3(squares.y + squares.z, squares.z + squares.x, squares.x + squares.y) -
                 dilated * (o.t0 * o.t0 + o.t1 * o.t1);
}

// `moments` are h, h p, h p², h p dy, h dy, h dy² (see blend_bwd.glsl); `depth` is d/dz from the channels.
//
// The exponent of a pixel d is |U d|² = FACTOR_SCALE² d·C⁻¹d, with (p, q) = U d and C = T Tᵀ + DILATION, T = J W R S. By a column v of T its
// derivative is -2 / FACTOR_SCALE² ((p, q)·U v) Uᵀ(p, q): nothing but moments of p and q, and U v, which is small where v is long. By
// way of C long axes would be multiplied by nearly canceling factors: a gradient of a Gaussian of condition number 1e7 had an
// error of a tenth.
SplatGradient project_gradient(Camera camera, Projection o, vec3 mean, vec3 log_scale, float moments[6], float depth) {
    SplatGradient g;
    float u11 = o.splat.factor.x, u12 = o.splat.factor.y, u22 = o.splat.factor.z;
    g.mean2d = screen_gradient(o, moments[1], moments[4]);
    // alpha dL/dalpha summed = -h / ln2; d(alpha)/d(logit) = alpha (1 - opacity)
    float by_log_alpha = -1.4426950408889634 * moments[0];
    g.opacity_logit = by_log_alpha * (1.0 - o.opacity);
    // U T, by columns: c t0 - b t1 without dilation is t1 x (t0 x t1).
    float root = inversesqrt(o.covariance.z), root_det = inversesqrt(o.determinant);
    vec3 along_p = FACTOR_SCALE * root_det * (root * (DILATION * o.t0 + cross(o.t1, cross(o.t0, o.t1))));
    vec3 along_q = u22 * o.t1;
    const float SLOPE = -2.0 / (FACTOR_SCALE * FACTOR_SCALE);
    float pp = SLOPE * moments[2], pq = SLOPE * u22 * moments[3], qq = SLOPE * u22 * u22 * moments[5];
    vec3 by_p = pp * along_p + pq * along_q, by_q = pq * along_p + qq * along_q;
    vec3 dt0 = u11 * by_p;
    vec3 dt1 = u12 * by_p + u22 * by_q;
    // By the logarithm of a column's length; all columns' lengths together go with focal/z.
    g.log_scale = by_p * along_p + by_q * along_q;
    if (MIP_FILTER) filter_gradient(o, by_log_alpha, dt0, dt1, g.log_scale);
    float dlog_f = g.log_scale.x + g.log_scale.y + g.log_scale.z;
    // Through the Jacobian.
    float inverse_z = 1.0 / o.point.z;
    vec2 f = camera.focal * inverse_z;
    mat3 w = camera_rotation(camera);
    mat3 r = quaternion_matrix(o.rotation);
    mat3 m = mat3(r[0] * o.scale.x, r[1] * o.scale.y, r[2] * o.scale.z);
    mat3 q = w * m;
    vec3 r2 = vec3(q[0].z, q[1].z, q[2].z);
    // Through the distortion.
    vec2 free_slope = o.point.xy * inverse_z;
    vec2 by_offset = g.mean2d, by_middle = vec2(0.0);
    vec3 t0 = o.t0, t1 = o.t1;
    g.radial = 0.0;
    if (DISTORTED) {
        t0 = f.x * (vec3(q[0].x, q[1].x, q[2].x) - o.slope.x * r2);
        t1 = f.y * (vec3(q[0].y, q[1].y, q[2].y) - o.slope.y * r2);
        // With offsets m at the clamped slope, and with a and b of `distortion_terms`: T = (a I + b m mᵀ) T', offset = a o + b m (m·(o - m)).
        vec2 m = camera.focal * o.slope, offset = camera.focal * free_slope, beyond = offset - m;
        vec2 terms = distortion_terms(camera, m);
        float unit = distortion_unit(camera);
        vec3 along = m.x * t0 + m.y * t1, by_along = m.x * dt0 + m.y * dt1;
        float by_mean = dot(g.mean2d, m), out_by = dot(m, beyond);
        float by_a = dot(dt0, t0) + dot(dt1, t1) + dot(g.mean2d, offset);
        float by_b = dot(by_along, along) + by_mean * out_by;
        g.radial = unit * (by_a * dot(m, m) + 2.0 * by_b);
        by_middle = terms.y * (vec2(dot(dt0, along) + dot(by_along, t0), dot(dt1, along) + dot(by_along, t1)) +
                               g.mean2d * out_by + by_mean * (beyond - m) + by_a * m);
        by_offset = terms.x * g.mean2d + terms.y * by_mean * m;
        dt0 = terms.x * dt0 + terms.y * m.x * by_along;
        dt1 = terms.x * dt1 + terms.y * m.y * by_along;
    }
    vec3 dr0 = f.x * dt0;
    vec3 dr1 = f.y * dt1;
    vec3 dr2 = -f.x * o.slope.x * dt0 - f.y * o.slope.y * dt1;
    vec2 dslope = vec2(-f.x * dot(dt0, r2), -f.y * dot(dt1, r2));
    if (DISTORTED) dslope += camera.focal * by_middle;
    vec2 dfree = camera.focal * by_offset + vec2(o.clamped.x ? 0.0 : dslope.x, o.clamped.y ? 0.0 : dslope.y);
    // Limits of the slope go with the principal point, and against the focal length.
    vec2 of_limit = vec2(o.clamped.x ? dslope.x : 0.0, o.clamped.y ? dslope.y : 0.0);
    g.lens.x = dot(dt0, t0) + dot(dt1, t1) + dot(by_offset, camera.focal * free_slope) - dot(of_limit, o.slope);
    if (DISTORTED) g.lens.x += dot(by_middle, camera.focal * o.slope);
    g.lens.yz = g.mean2d * camera.focal - of_limit;
    vec3 dpoint = vec3(dfree * inverse_z, 0.0);
    dpoint.z = depth - dot(dfree, free_slope) * inverse_z - dlog_f * inverse_z;
    // Camera space to world.
    g.mean = transpose(w) * dpoint;
    mat3 dq = transpose(mat3(dr0, dr1, dr2)); // dq[j] is the gradient of column j of q
    mat3 dm = transpose(w) * dq;
    g.log_scale = vec3(log_scale.x < LOG_SCALE_MIN || log_scale.x > LOG_SCALE_MAX ? 0.0 : g.log_scale.x,
                       log_scale.y < LOG_SCALE_MIN || log_scale.y > LOG_SCALE_MAX ? 0.0 : g.log_scale.y,
                       log_scale.z < LOG_SCALE_MIN || log_scale.z > LOG_SCALE_MAX ? 0.0 : g.log_scale.z);
    mat3 dr = mat3(dm[0] * o.scale.x, dm[1] * o.scale.y, dm[2] * o.scale.z);
    float qw = o.rotation.x, qx = o.rotation.y, qy = o.rotation.z, qz = o.rotation.w;
    // dr[column][row]
    vec4 dunit = 2.0 * vec4(
        qx * (dr[1][2] - dr[2][1]) + qy * (dr[2][0] - dr[0][2]) + qz * (dr[0][1] - dr[1][0]),
        -2.0 * qx * (dr[1][1] + dr[2][2]) + qy * (dr[1][0] + dr[0][1]) + qz * (dr[2][0] + dr[0][2]) +
            qw * (dr[1][2] - dr[2][1]),
        qx * (dr[1][0] + dr[0][1]) - 2.0 * qy * (dr[0][0] + dr[2][2]) + qz * (dr[2][1] + dr[1][2]) +
            qw * (dr[2][0] - dr[0][2]),
        qx * (dr[2][0] + dr[0][2]) + qy * (dr[2][1] + dr[1][2]) - 2.0 * qz * (dr[0][0] + dr[1][1]) +
            qw * (dr[0][1] - dr[1][0]));
    g.rotation = (dunit - o.rotation * dot(o.rotation, dunit)) * o.inverse_norm;
    // The camera's own rows: point = W mean + t, q = W m.
    mat3 dw_columns = mat3(0.0);
    [[unroll]] for (int j = 0; j < 3; ++j) {
        // d/dW[row][col] = dpoint[row] mean[col] + sum_axis dq[axis][row] m[axis][col]
        dw_columns[j] = dpoint * mean[j] + dq[0] * m[0][j] + dq[1] * m[1][j] + dq[2] * m[2][j];
    }
    g.camera_rows = transpose(dw_columns);
    g.camera_translation = dpoint;
    g.camera_turn = cross(dm[0], m[0]) + cross(dm[1], m[1]) + cross(dm[2], m[2]);
    return g;
}
