//! Parameter groups of a scene.

/// Number of semantic features per Gaussian (method: 32, decoded to 512).
pub const SEMANTIC_FEATURES: u32 = 32;

/// Parameter group of the Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// Centers in world space.
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
    /// Normals in world space, of any length.
    Normals,
    /// Semantic features, blended without projection. The decoder maps them to embeddings.
    Semantics,
}

impl Group {
    /// Number of groups.
    pub const COUNT: usize = 10;

    /// All groups.
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

    /// Returns the scalars per Gaussian.
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

    /// Returns the name of the group, as in names of buffers and passes.
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

/// Parameter groups of a scene's Gaussians. Determined once; it selects kernels and is never a branch within one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Model {
    /// Highest band of spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// Whether Gaussians have normals.
    pub normals: bool,
    /// Whether Gaussians have semantic features.
    pub semantics: bool,
    /// Whether projection scales opacities by the 2D Mip filter. Changes no parameter.
    pub mip: bool,
}

impl Model {
    /// Returns whether the model has a group.
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

    /// Returns the groups of the model.
    pub fn groups(&self) -> impl Iterator<Item = Group> + '_ {
        Group::ALL.into_iter().filter(|g| self.has(*g))
    }

    /// Returns the scalars per Gaussian over all groups.
    pub fn width(&self) -> u32 {
        self.groups().map(Group::width).sum()
    }
}
