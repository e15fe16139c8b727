// Physical lights: point, sphere, rectangle, disk, spot, directional, lobe, window. `AreaLight::record` fills the records.
//
// A record has no color. Colors are radiance of spheres, rectangles and disks, radiant intensity of points, spots and lobes,
// and irradiance at normal incidence of directional lights.

const uint LIGHT_POINT = 0u;
const uint LIGHT_SPHERE = 1u;
const uint LIGHT_RECTANGLE = 2u;
const uint LIGHT_DISK = 3u;
const uint LIGHT_SPOT = 4u;
const uint LIGHT_DIRECTIONAL = 5u;
const uint LIGHT_LOBE = 6u; // point with a spherical Gaussian
const uint LIGHT_WINDOW = 7u; // a rectangle; a record for each channel
// Stands for the index of the light in the sample points of windows.
const uint LIGHT_WINDOW_POINTS = 0x7fffffffu;

struct LightRecord {
    vec3 origin;  // position, center or corner; directional: unit direction to the light
    uint kind;
    vec3 axis;    // rectangle, window: first edge; disk: unit tangent; spot, lobe: unit axis
    float radius; // sphere, disk; directional: sine of the angular radius; spot: factor of the cosine; lobe: sharpness
    vec3 side;    // rectangle, window: second edge; disk: unit tangent across `axis`
    float bias;   // spot: added to the scaled cosine; window: channel
    vec3 normal;  // rectangle, window, disk: unit normal of the side that emits
    float area;   // rectangle, window, disk
};

// Whether the light is at a point. Such lights have an intensity, and no extent.
bool light_is_point(uint kind) { return kind == LIGHT_POINT || kind == LIGHT_SPOT || kind == LIGHT_LOBE; }
