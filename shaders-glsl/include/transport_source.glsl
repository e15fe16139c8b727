// Reflectance of receivers and the light that they reflect first, for the pass and its gradients.

layout(constant_id = 1) const bool METALLIC = false; // without it metallic is 0 everywhere

IN(vec4, materials);    // [surfels]: linear albedo, roughness
IN(float, metallic);    // [surfels]
IN(vec3, enclosure);    // [6]: raw albedo of the faces
IN(uint, faces);        // [patches]
IN(float, unit);        // [lights * receivers]
IN(vec3, log_colors);   // [lights]

const float PI = 3.14159265358979;
// Hemispherical reflectance of a patch's specular lobe.
const float SHEEN = 0.03;
// The lobe of a surfel is that of this cosine between normal and viewer, which stands for all directions:
// 2^(-9.28 * 0.6).
const float GRAZING = 0.02108085;

struct Reflectance {
    vec3 value;
    vec3 by_albedo;    // of the same channel
    vec3 by_roughness;
    vec3 by_metallic;
};

// Diffuse reflection and the split sum of the specular lobe, approximated as by Karis (2014).
Reflectance reflectance_of(vec3 albedo, float r, float m) {
    vec4 q = vec4(1.0 - r, 0.0425 - 0.0275 * r, 1.04 - 0.572 * r, 0.022 * r - 0.04);
    bool smooth_ = q.x * q.x >= GRAZING;
    float a = (smooth_ ? GRAZING : q.x * q.x) * q.x + q.y;
    float a_by_r = -(smooth_ ? GRAZING : 3.0 * q.x * q.x) - 0.0275;
    float scale = q.z - 1.04 * a, bias = q.w + 1.04 * a;
    float scale_by_r = -0.572 - 1.04 * a_by_r, bias_by_r = 0.022 + 1.04 * a_by_r;
    vec3 f0 = 0.04 * (1.0 - m) + albedo * m;
    vec3 specular = f0 * scale + bias;
    vec3 value = albedo * (1.0 - m) + specular;
    // 1 where the value is within its bounds.
    vec3 inside = vec3(lessThan(value, vec3(1.0)));
    vec3 shines = inside * vec3(greaterThan(specular, vec3(0.0)));
    Reflectance o;
    o.value = min(albedo * (1.0 - m) + max(specular, vec3(0.0)), vec3(1.0));
    o.by_albedo = inside * (1.0 - m) + shines * m * scale;
    o.by_roughness = shines * (f0 * scale_by_r + bias_by_r);
    o.by_metallic = shines * (albedo - 0.04) * scale - inside * albedo;
    return o;
}

vec3 face_albedo(uint face) { return 1.0 / (1.0 + exp(-enclosure[face])); }
