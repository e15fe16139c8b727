// Regularizers of densification by Markov chain Monte Carlo (Kheradmand et al. 2024, section 3.3): the weighted means of opacities and of
// scales over all Gaussians. Included after splat.glsl.

// Gradient by the logit of an opacity.
float opacity_regularizer(float weight, uint gaussians, float logit) {
    float opacity = 1.0 / (1.0 + exp(-clamp(logit, -80.0, 80.0)));
    return weight / float(max(gaussians, 1u)) * opacity * (1.0 - opacity);
}

// Gradient by the logarithms of scales. Scales beyond the limits of projection have no gradient there, and none here.
vec3 scale_regularizer(float weight, uint gaussians, vec3 log_scale) {
    vec3 scale = exp(clamp(log_scale, LOG_SCALE_MIN, LOG_SCALE_MAX));
    bvec3 beyond = bvec3(log_scale.x < LOG_SCALE_MIN || log_scale.x > LOG_SCALE_MAX,
                         log_scale.y < LOG_SCALE_MIN || log_scale.y > LOG_SCALE_MAX,
                         log_scale.z < LOG_SCALE_MIN || log_scale.z > LOG_SCALE_MAX);
    return weight / (3.0 * float(max(gaussians, 1u))) * mix(scale, vec3(0.0), beyond);
}
