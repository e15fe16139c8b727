//! What training learns of the views: corrections of their cameras, factors on their colors, and the lens.
//!
//! A correction is a shift of the camera's center and a turn about it, in world axes; the factors are those of red, green
//! and blue. The mean of each number over all views is zero: a motion or a tint of the whole scene shows in no photograph.
//! All views share a lens: a factor on focal lengths, a shift of the principal point, vignetting, and radial distortion.

use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::LearnedView;

/// Kinds of numbers that training learns of views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ViewKinds {
    /// Poses of cameras.
    pub cameras: bool,
    /// Factors on colors.
    pub gains: bool,
    /// Focal length, principal point and radial distortion that all views share.
    ///
    /// With `gains`, also vignetting.
    pub lens: bool,
}

impl ViewKinds {
    /// Returns whether anything is learned.
    pub fn any(self) -> bool {
        self.cameras || self.gains || self.lens
    }

    /// Returns whether cameras differ from those that were given.
    pub fn moves_pixels(self) -> bool {
        self.cameras || self.lens
    }
}

/// Learned numbers of all views and of the lens, in device memory.
///
/// Each has its moments.
#[derive(Debug)]
pub struct LearnedViews {
    views: DeviceBuffer,
    count: u32,
}

/// Handle of [`LearnedViews`] in a graph.
#[derive(Clone, Copy, Debug)]
pub struct ViewHandles {
    /// `[views + 1]` of `LearnedView`; the last is the lens.
    pub views: Buffer,
    /// Number of views.
    pub count: u32,
    /// Kinds that are learned.
    pub kinds: ViewKinds,
}

/// Bytes of a view's numbers and moments.
const BYTES: u64 = size_of::<LearnedView>() as u64;

impl LearnedViews {
    /// Allocates the numbers of `count` views. All are zero: cameras and colors as they are.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, count: u32) -> Result<LearnedViews> {
        let views = device.buffer("learned_views", LearnedViews::bytes(count), Location::Device)?;
        device.fill(&views, 0)?;
        Ok(LearnedViews { views, count })
    }

    /// Returns the number of views.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Returns the bytes of the numbers of `count` views and of the lens.
    pub fn bytes(count: u32) -> u64 {
        BYTES * (u64::from(count) + 1)
    }

    /// Downloads the numbers and moments of all views; those of the lens come last.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<Vec<LearnedView>> {
        device.download_as(&self.views, self.count as usize + 1)
    }

    /// Replaces the numbers and moments of all views, and of the lens after them.
    ///
    /// # Errors
    /// If the device fails, or there are more views than fit.
    pub fn upload(&self, device: &Device, views: &[LearnedView]) -> Result<()> {
        device.upload(&self.views, 0, bytemuck::cast_slice(views))
    }

    pub(crate) fn declare(g: &mut Graph, count: u32, kinds: ViewKinds) -> ViewHandles {
        ViewHandles { views: g.external("learned_views", LearnedViews::bytes(count)), count, kinds }
    }

    pub(crate) fn bind(&self, exec: &mut Executor, handles: &ViewHandles) -> Result<()> {
        exec.bind(handles.views, &self.views)
    }
}
