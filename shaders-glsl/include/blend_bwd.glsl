// Contribution of one pixel to the gradients of one splat, in an order of arithmetic that both backward kernels share.
//
// Walking front to back, R is the loss gradient that remains for this splat and all behind it:
//   R before the first splat = sum_c image_c g_c + T_end g_T ("debt"),   minus w_j (f_j . g) after each splat j.
// Then dL/dalpha = T (f . g) - (R after this splat) / (1 - alpha): one number a pixel, whatever the channels.
// Moments of h = dL/d(exponent) accumulate; project_bwd turns them into gradients of mean and factor.

const uint MOMENTS = 6u; // h, h p, h p², h p dy, h dy, h dy²
