// Backward of projection for one splat: from the sums that blending left at its entries to its parameters.
// Included after splat.glsl and sh.glsl.

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
};

// `moments` are h, h p, h p dx, h p dy, h dy, h dy² (see blend_bwd.glsl); `depth` is d/dz from the channels.
SplatGradient project_gradient(Camera camera, Projection o, vec3 mean, vec3 log_scale, float moments[6], float depth) {
    SplatGradient g;
    float u11 = o.splat.factor.x, u12 = o.splat.factor.y, u22 = o.splat.factor.z;
    g.mean2d = -2.0 * vec2(u11 * moments[1], u12 * moments[1] + u22 * u22 * moments[4]);
    vec3 factor = 2.0 * vec3(moments[2], moments[3], u22 * moments[5]);
    // alpha dL/dalpha summed = -h / ln2; d(alpha)/d(logit) = alpha (1 - opacity)
    g.opacity_logit = -1.4426950408889634 * moments[0] * (1.0 - o.splat.opacity);
    // Factor to covariance.
    float a = o.covariance.x, b = o.covariance.y, c = o.covariance.z, det = o.determinant;
    float half11 = 0.5 * factor.x * u11, half12 = 0.5 * factor.y * u12, half22 = 0.5 * factor.z * u22;
    float inverse_det = 1.0 / det;
    float da = -(half11 + half12) * c * inverse_det;
    float db = 2.0 * (half11 + half12) * b * inverse_det - factor.y * FACTOR_SCALE * inversesqrt(c * det);
    float dc = (half11 - half12 - half22) / c - (half11 + half12) * a * inverse_det;
    // Covariance to the rows of J W R S.
    vec3 dt0 = 2.0 * da * o.t0 + db * o.t1;
    vec3 dt1 = 2.0 * dc * o.t1 + db * o.t0;
    // Through the Jacobian.
    float inverse_z = 1.0 / o.point.z;
    vec2 f = camera.focal * inverse_z;
    mat3 w = camera_rotation(camera);
    mat3 r = quaternion_matrix(o.rotation);
    mat3 m = mat3(r[0] * o.scale.x, r[1] * o.scale.y, r[2] * o.scale.z);
    mat3 q = w * m;
    vec3 r0 = vec3(q[0].x, q[1].x, q[2].x);
    vec3 r1 = vec3(q[0].y, q[1].y, q[2].y);
    vec3 r2 = vec3(q[0].z, q[1].z, q[2].z);
    vec3 dr0 = f.x * dt0;
    vec3 dr1 = f.y * dt1;
    vec3 dr2 = -f.x * o.slope.x * dt0 - f.y * o.slope.y * dt1;
    vec2 df = vec2(dot(dt0, r0 - o.slope.x * r2), dot(dt1, r1 - o.slope.y * r2)); // d/d(focal/z)
    vec2 dslope = vec2(-f.x * dot(dt0, r2), -f.y * dot(dt1, r2));
    vec2 free_slope = o.point.xy * inverse_z;
    vec2 dfree = camera.focal * g.mean2d + vec2(o.held.x ? 0.0 : dslope.x, o.held.y ? 0.0 : dslope.y);
    vec3 dpoint = vec3(dfree * inverse_z, 0.0);
    dpoint.z = depth - dot(dfree, free_slope) * inverse_z - dot(df, f) * inverse_z;
    // Camera space to world.
    g.mean = transpose(w) * dpoint;
    mat3 dq = transpose(mat3(dr0, dr1, dr2)); // dq[j] is the gradient of column j of q
    mat3 dm = transpose(w) * dq;
    g.log_scale = vec3(dot(dm[0], r[0]), dot(dm[1], r[1]), dot(dm[2], r[2])) * o.scale;
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
    return g;
}
