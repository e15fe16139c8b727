//! Color schemes: matching paints, woods and fabrics of a room.

use glam::Vec3;

use crate::color::hex;
use crate::rng::Rng;

/// Colors of one room, linear.
#[derive(Debug, Clone)]
pub(crate) struct Theme {
    /// Walls without pattern.
    pub(crate) wall: Vec3,
    /// Ground and figure of the papered wall.
    pub(crate) paper: [Vec3; 2],
    /// Floor, light and dark.
    pub(crate) floor: [Vec3; 2],
    /// Furniture wood, light and dark.
    pub(crate) wood: [Vec3; 2],
    /// Sofa cloth.
    pub(crate) sofa: [Vec3; 2],
    /// Armchair cloth.
    pub(crate) armchair: [Vec3; 2],
    /// Rug.
    pub(crate) rug: [Vec3; 4],
    /// Cushions, curtains, ceramics.
    pub(crate) accents: [Vec3; 4],
    /// Inks of wall pictures.
    pub(crate) inks: [Vec3; 5],
    /// Brass, copper or steel.
    pub(crate) metal: Vec3,
}

/// Display colors in the order of [`Theme`]'s fields.
struct Palette {
    wall: u32,
    paper: [u32; 2],
    floor: [u32; 2],
    wood: [u32; 2],
    sofa: [u32; 2],
    armchair: [u32; 2],
    rug: [u32; 4],
    accents: [u32; 4],
    inks: [u32; 5],
    metal: u32,
}

const PALETTES: [Palette; 6] = [
    Palette {
        wall: 0xe6e0d4,
        paper: [0x7d9a94, 0x628079],
        floor: [0xc79a68, 0x8f6740],
        wood: [0x8f5c38, 0x6a4128],
        sofa: [0x66809a, 0x4d6379],
        armchair: [0xcc7f45, 0xb06432],
        rug: [0xd2c3a5, 0x8a3b2e, 0x35546a, 0xe4d7bc],
        accents: [0xd9a441, 0x9c4434, 0xe9e2d2, 0x3f6b63],
        inks: [0xe8dcc0, 0xd98f4e, 0x4c7a85, 0x24384a, 0xf2c14e],
        metal: 0xeac983,
    },
    Palette {
        wall: 0xe3e4d8,
        paper: [0xc08c72, 0xa5735a],
        floor: [0xa98663, 0x745639],
        wood: [0xb98a58, 0x94693f],
        sofa: [0x8b9a78, 0x6c7c5b],
        armchair: [0xe2cda6, 0xcbb184],
        rug: [0x35544a, 0xdad0b2, 0xb5653a, 0x8a9b74],
        accents: [0xb5653a, 0xe8dfc5, 0x2f4a3f, 0xd6a756],
        inks: [0xf0e6d0, 0xc96f4a, 0x5f7a5e, 0x2d463c, 0xe3b964],
        metal: 0xe6b08f,
    },
    Palette {
        wall: 0xdde2e6,
        paper: [0x3b5675, 0x50698a],
        floor: [0xd0b087, 0xa5835a],
        wood: [0x5e4636, 0x453226],
        sofa: [0xc2bbae, 0xa39b8d],
        armchair: [0xac4640, 0x8e3732],
        rug: [0x2f4763, 0xe0dbd0, 0xb34a41, 0x7f97b0],
        accents: [0xb34a41, 0x2f4763, 0xe8c66a, 0xe6e3dc],
        inks: [0xe9e7df, 0x7fa0b8, 0x3a5573, 0x1e2d40, 0xd9534a],
        metal: 0xd6d8dc,
    },
    Palette {
        wall: 0xeae2de,
        paper: [0x85587a, 0x734a69],
        floor: [0x8c6649, 0x5f4332],
        wood: [0xcaa273, 0xa98155],
        sofa: [0xcdbda8, 0xb09e88],
        armchair: [0x557777, 0x42605f],
        rug: [0x6c435c, 0xe2d2c2, 0x557777, 0xc79a86],
        accents: [0x557777, 0xd39a6a, 0x7a4e68, 0xefe6da],
        inks: [0xf1e4da, 0xd7a488, 0x8a5f80, 0x43304a, 0xe8c27a],
        metal: 0xe8bfa2,
    },
    Palette {
        wall: 0xefe4cb,
        paper: [0xdcae62, 0xc9974a],
        floor: [0xae8660, 0x7c5b3e],
        wood: [0x6f4a31, 0x523522],
        sofa: [0x98573f, 0x7c4430],
        armchair: [0x4e6a79, 0x3d5562],
        rug: [0xe0cfa4, 0x98573f, 0x4e6a79, 0xc98f3e],
        accents: [0x4e6a79, 0xe6c98a, 0x98573f, 0x6c7f55],
        inks: [0xf3e4bf, 0xe0a050, 0x7c9480, 0x34504f, 0xc25a3a],
        metal: 0xeac983,
    },
    Palette {
        wall: 0xd9dcd9,
        paper: [0x9db3a2, 0x84a08c],
        floor: [0xb9a58a, 0x8d7a60],
        wood: [0xd2b48c, 0xb08f66],
        sofa: [0x4d6b5f, 0x3a5349],
        armchair: [0xd98d7a, 0xc27462],
        rug: [0xe6ddcd, 0x4d6b5f, 0xd98d7a, 0xb9a58a],
        accents: [0xd98d7a, 0xe9d7a0, 0x3f5f74, 0xf0ece2],
        inks: [0xeee6d6, 0xe4a58c, 0x7d9c8c, 0x36564c, 0xe0b653],
        metal: 0xd6d8dc,
    },
];

impl Theme {
    /// Chooses a scheme and shifts its colors slightly at random.
    pub(crate) fn choose(rng: &mut Rng) -> Self {
        let palette = rng.pick(&PALETTES);
        let mut tint = |rgb: u32, amount: f32| {
            let shift = Vec3::new(rng.range(-amount, amount), rng.range(-amount, amount), rng.range(-amount, amount));
            (hex(rgb) * (Vec3::ONE + shift)).clamp(Vec3::splat(0.015), Vec3::splat(0.84))
        };
        Self {
            wall: tint(palette.wall, 0.04),
            paper: palette.paper.map(|c| tint(c, 0.12)),
            floor: palette.floor.map(|c| tint(c, 0.08)),
            wood: palette.wood.map(|c| tint(c, 0.08)),
            sofa: palette.sofa.map(|c| tint(c, 0.1)),
            armchair: palette.armchair.map(|c| tint(c, 0.1)),
            rug: palette.rug.map(|c| tint(c, 0.1)),
            accents: palette.accents.map(|c| tint(c, 0.1)),
            inks: palette.inks.map(|c| tint(c, 0.1)),
            metal: tint(palette.metal, 0.02),
        }
    }
}
