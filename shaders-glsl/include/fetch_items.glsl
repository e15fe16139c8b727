// Features of the pixels that the items of a batch are, into `staged`: FETCH_ITEMS(pixel), in which `t` and `n` are the tile
// and the item of this lane's side. Needs the buffer `image`, CHANNELS and FIRST.
#define FETCH_ITEMS(pixel)                                                                                     \
    SHORT for (uint t = 0u; t < TILES; t++) {                                                                  \
        SHORT for (uint n = 0u; n < ACROSS; n++) {                                                             \
            uint at_ = (pixel) * CHANNELS + FIRST + column();                                                  \
            EACH_HELD(h_) staged[t * SPREAD + n * HELD + h_] = image[at_ + h_ * ACROSS];                       \
        }                                                                                                      \
    }
