// Physical lights: point, sphere, rectangle, disk, spot, directional, window. `AreaLight::record` fills the records.
//
// A record has no color. Colors are radiance of spheres, rectangles and disks, radiant intensity of points and spots, and
// irradiance at normal incidence of directional lights.

const uint LIGHT_POINT = 0u;
const uint LIGHT_SPHERE = 1u;
const uint LIGHT_RECTANGLE = 2u;
const uint LIGHT_DISK = 3u;
const uint LIGHT_SPOT = 4u;
const uint LIGHT_DIRECTIONAL = 5u;
const uint LIGHT_WINDOW = 7u; // a rectangle; a record for each channel
// Stands for the index of the light in the sample points of windows.
const uint LIGHT_WINDOW_POINTS = 0x7fffffffu;

struct LightRecord {
    vec3 origin;  // position, center or corner; directional: unit direction to the light
    uint kind;
    vec3 axis;    // rectangle, window: first edge; disk: unit tangent; spot: unit axis
    float radius; // sphere, disk; directional: sine of the angular radius; spot: factor of the cosine
    vec3 side;    // rectangle, window: second edge; disk: unit tangent across `axis`
    float bias;   // spot: added to the scaled cosine; window: channel
    vec3 normal;  // rectangle, window, disk: unit normal of the side that emits
    float area;   // rectangle, window, disk
};
