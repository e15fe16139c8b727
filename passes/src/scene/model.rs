//! Which parameter groups a scene has.

/// Semantic features of a Gaussian (method: 32, decoded to 512).
pub const SEMANTIC_FEATURES: u32 = 32;

/// A parameter group of the Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// Centers, world.
    Means,
    /// Logarithms of scales.
    LogScales,
    /// Quaternions w, x, y, z.
    Rotations,
    /// Opacities before the sigmoid.
    OpacityLogits,
    /// Spherical harmonics, band 0.
    Sh0,
    /// Band 1.
    Sh1,
    /// Band 2.
    Sh2,
    /// Band 3.
    Sh3,
    /// Normals, world, any length.
    Normals,
    /// Semantic features, blended as they are; a decoder gives them a meaning.
    Semantics,
}

impl Group {
    /// How many groups there can be.
    pub const COUNT: usize = 10;

    /// Every group there can be.
    pub const ALL: [Group; Group::COUNT] = [
        Group::Means,
        Group::LogScales,
        Group::Rotations,
        Group::OpacityLogits,
        Group::Sh0,
        Group::Sh1,
        Group::Sh2,
        Group::Sh3,
        Group::Normals,
        Group::Semantics,
    ];

    /// Scalars of one Gaussian.
    pub fn width(self) -> u32 {
        match self {
            Group::Means | Group::LogScales | Group::Sh0 | Group::Normals => 3,
            Group::Rotations => 4,
            Group::OpacityLogits => 1,
            Group::Sh1 => 9,
            Group::Sh2 => 15,
            Group::Sh3 => 21,
            Group::Semantics => SEMANTIC_FEATURES,
        }
    }

    /// The field's name for it.
    pub fn name(self) -> &'static str {
        match self {
            Group::Means => "means",
            Group::LogScales => "log_scales",
            Group::Rotations => "rotations",
            Group::OpacityLogits => "opacity_logits",
            Group::Sh0 => "sh0",
            Group::Sh1 => "sh1",
            Group::Sh2 => "sh2",
            Group::Sh3 => "sh3",
            Group::Normals => "normals",
            Group::Semantics => "semantics",
        }
    }
}

/// What a scene's Gaussians carry. Worked out once; it chooses kernels, and never becomes a branch inside one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Model {
    /// Highest band of spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// Whether there are normals.
    pub normals: bool,
    /// Whether there are semantic features.
    pub semantics: bool,
}

impl Model {
    /// Whether the model has a group.
    pub fn has(&self, group: Group) -> bool {
        match group {
            Group::Sh1 => self.sh_degree >= 1,
            Group::Sh2 => self.sh_degree >= 2,
            Group::Sh3 => self.sh_degree >= 3,
            Group::Normals => self.normals,
            Group::Semantics => self.semantics,
            _ => true,
        }
    }

    /// The groups it has.
    pub fn groups(&self) -> impl Iterator<Item = Group> + '_ {
        Group::ALL.into_iter().filter(|g| self.has(*g))
    }

    /// Scalars of one Gaussian over all groups.
    pub fn width(&self) -> u32 {
        self.groups().map(Group::width).sum()
    }
}
