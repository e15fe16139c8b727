// Real spherical harmonics up to degree 3 in the order and sign of every 3DGS file.

const float SH0 = 0.28209479177387814;
const float SH1 = 0.48860251190291992;
const float SH2[5] = float[](1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792,
                             0.54627421529603959);
const float SH3[7] = float[](-0.59004358992664352, 2.8906114426405538, -0.45704579946446572, 0.37317633259011540,
                             -0.45704579946446572, 1.4453057213202769, -0.59004358992664352);

// Basis functions 1..3 of band 1 and so on, given a unit direction; those above `degree` are zero.
void sh_basis(vec3 d, uint degree, out float b[16]) {
    float x = d.x, y = d.y, z = d.z;
    float xx = x * x, yy = y * y, zz = z * z;
    float one = degree >= 1u ? 1.0 : 0.0, two = degree >= 2u ? 1.0 : 0.0, three = degree >= 3u ? 1.0 : 0.0;
    b[0] = SH0;
    b[1] = one * -SH1 * y;
    b[2] = one * SH1 * z;
    b[3] = one * -SH1 * x;
    b[4] = two * SH2[0] * x * y;
    b[5] = two * SH2[1] * y * z;
    b[6] = two * SH2[2] * (2.0 * zz - xx - yy);
    b[7] = two * SH2[3] * x * z;
    b[8] = two * SH2[4] * (xx - yy);
    b[9] = three * SH3[0] * y * (3.0 * xx - yy);
    b[10] = three * SH3[1] * x * y * z;
    b[11] = three * SH3[2] * y * (4.0 * zz - xx - yy);
    b[12] = three * SH3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    b[13] = three * SH3[4] * x * (4.0 * zz - xx - yy);
    b[14] = three * SH3[5] * z * (xx - yy);
    b[15] = three * SH3[6] * x * (xx - 3.0 * yy);
}

// Gradient of sum_k s[k] * basis_k with respect to the direction's components.
vec3 sh_direction_gradient(vec3 d, uint degree, float s[16]) {
    float x = d.x, y = d.y, z = d.z;
    float xx = x * x, yy = y * y, zz = z * z;
    vec3 g = vec3(0.0);
    if (degree >= 1u) g += SH1 * vec3(-s[3], -s[1], s[2]);
    if (degree >= 2u) {
        g += SH2[0] * s[4] * vec3(y, x, 0.0) + SH2[1] * s[5] * vec3(0.0, z, y) +
             SH2[2] * s[6] * vec3(-2.0 * x, -2.0 * y, 4.0 * z) + SH2[3] * s[7] * vec3(z, 0.0, x) +
             SH2[4] * s[8] * vec3(2.0 * x, -2.0 * y, 0.0);
    }
    if (degree >= 3u) {
        g += SH3[0] * s[9] * vec3(6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0);
        g += SH3[1] * s[10] * vec3(y * z, x * z, x * y);
        g += SH3[2] * s[11] * vec3(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
        g += SH3[3] * s[12] * vec3(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
        g += SH3[4] * s[13] * vec3(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
        g += SH3[5] * s[14] * vec3(2.0 * x * z, -2.0 * y * z, xx - yy);
        g += SH3[6] * s[15] * vec3(3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0);
    }
    return g;
}
