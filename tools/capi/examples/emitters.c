/* A C program that lists the emitters of a run, renders the room under each of them, with bounces, and adds one.
 *
 *     emitters RUN X Y Z
 *
 * The camera stands at X Y Z and looks along z. The images under each emitter alone must add up to the image under all.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "sgs.h"

enum { WIDTH = 48, HEIGHT = 36, FLOATS = 3 * WIDTH * HEIGHT };

static SgsContext *context;
static SgsRelight relight;

static void sgs(SgsResult result, const char *what) {
    char why[1024] = "";
    if (result == SGS_OK) return;
    sgs_last_error(context, why, sizeof why, NULL);
    fprintf(stderr, "%s: %s\n", what, why);
    exit(1);
}

/* Switches all emitters off except one, or on if `one` is -1. Emitters that are off in the file stay off. */
static void only(int one, const SgsLight *before, uint32_t count) {
    for (uint32_t i = 0; i < count; ++i) {
        SgsLight light = before[i];
        light.on = before[i].on && (one < 0 || (int)i == one);
        sgs(sgs_relight_light_set(context, relight, i, &light), "set");
    }
}

int main(int argc, char **argv) {
    static const char *const shapes[] = {"point", "sphere",      "rectangle", "disk",
                                         "spot",  "directional", "lobe",      "window"};
    static float all[FLOATS], sum[FLOATS], one[FLOATS];
    char why[1024];
    SgsRelightState state = {sizeof state};
    SgsRelitInfo render = {sizeof render};
    SgsCamera camera = {sizeof camera};
    SgsLight before[64], colored = {sizeof colored};
    SgsEmitter spot = {sizeof spot};
    uint32_t count, added;
    float largest = 0.0f, apart = 0.0f, change = 0.0f, flash = 0.0f, left = 0.0f;
    if (argc != 5) {
        fprintf(stderr, "usage: emitters RUN X Y Z\n");
        return 2;
    }
    if (sgs_context_open(NULL, &context, why, sizeof why) != SGS_OK) {
        fprintf(stderr, "context: %s\n", why);
        return 1;
    }
    sgs(sgs_relight_open(context, argv[1], NULL, &relight), "open");
    sgs(sgs_relight_get(context, relight, &state), "state");
    sgs(sgs_relight_light_count(context, relight, &count), "count");
    if (!state.emitters || count > 64) {
        fprintf(stderr, "The run has no emitters, or more than 64.\n");
        return 1;
    }
    for (uint32_t i = 0; i < count; ++i) {
        SgsEmitter emitter = {sizeof emitter};
        char name[64];
        before[i].struct_size = sizeof before[i];
        sgs(sgs_relight_light_get(context, relight, i, &before[i]), "get");
        sgs(sgs_relight_emitter_get(context, relight, i, &emitter, name, sizeof name), "emitter");
        printf("%s: %s%s, color %g %g %g\n", name, shapes[emitter.shape], before[i].on ? "" : ", off",
               emitter.color[0], emitter.color[1], emitter.color[2]);
    }

    camera.width = WIDTH, camera.height = HEIGHT;
    camera.focal[0] = camera.focal[1] = 0.5f * WIDTH;
    camera.center[0] = 0.5f * WIDTH, camera.center[1] = 0.5f * HEIGHT;
    for (int i = 0; i < 3; ++i) {
        camera.world_to_camera[5 * i] = 1.0f;
        camera.world_to_camera[4 * i + 3] = -(float)atof(argv[2 + i]);
    }
    render.layer = SGS_LAYER_SHADED;
    sgs(sgs_relight_render(context, relight, &camera, &render, all, FLOATS), "render all");
    for (uint32_t i = 0; i < count; ++i) {
        only((int)i, before, count);
        sgs(sgs_relight_render(context, relight, &camera, &render, one, FLOATS), "render one");
        for (int k = 0; k < FLOATS; ++k) sum[k] += one[k];
    }
    only(-1, before, count);
    colored = before[0];
    colored.gain = 0.5f, colored.color[0] = 0.0f;
    sgs(sgs_relight_light_set(context, relight, 0, &colored), "recolor");
    sgs(sgs_relight_render(context, relight, &camera, &render, one, FLOATS), "render recolored");
    for (int k = 0; k < FLOATS; ++k) {
        largest = fmaxf(largest, all[k]);
        apart = fmaxf(apart, fabsf(all[k] - sum[k]));
        change = fmaxf(change, fabsf(all[k] - one[k]));
    }
    sgs(sgs_relight_light_set(context, relight, 0, &before[0]), "restore");
    /* A spot at the camera that shines where it looks. It is removed again. */
    spot.shape = SGS_EMITTER_SPOT;
    for (int i = 0; i < 3; ++i) {
        spot.color[i] = 2.0f;
        spot.position[i] = (float)atof(argv[2 + i]);
    }
    spot.axis[2] = 1.0f, spot.angles[0] = 10.0f, spot.angles[1] = 30.0f;
    sgs(sgs_relight_emitter_add(context, relight, &spot, "flash", &added), "add");
    sgs(sgs_relight_render(context, relight, &camera, &render, one, FLOATS), "render the flash");
    for (int k = 0; k < FLOATS; ++k) flash = fmaxf(flash, one[k] - all[k]);
    sgs(sgs_relight_light_remove(context, relight, added), "remove");
    sgs(sgs_relight_render(context, relight, &camera, &render, one, FLOATS), "render without it");
    for (int k = 0; k < FLOATS; ++k) left = fmaxf(left, fabsf(all[k] - one[k]));
    sgs(sgs_destroy(context, relight), "destroy");
    sgs(sgs_context_destroy(&context), "destroy context");
    printf("%u emitters, up to %.2g; recolored, up to %.2g less\n", count, largest, change);
    if (largest <= 0.0f || apart > 1e-5f * largest) return fprintf(stderr, "emitters alone are not all light\n"), 1;
    if (change < 0.01f * largest) return fprintf(stderr, "a recolored emitter changes nothing\n"), 1;
    if (flash < 0.01f * largest) return fprintf(stderr, "an added emitter changes nothing\n"), 1;
    if (left > 1e-5f * largest) return fprintf(stderr, "a removed emitter shines\n"), 1;
    return 0;
}
