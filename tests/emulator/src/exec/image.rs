//! Storage images: texels in packed memory.

use super::subgroup::{Subgroup, lanes};
use super::{Machine, at};
use crate::code::{NONE, Place, Slot, Space};
use crate::fault::Fault;
use crate::memory::Kind;
use half::f16;
use sgs_engine::ImageFormat;

/// Returns the words of a texel with these components.
pub(crate) fn encode(format: ImageFormat, texel: [u32; 4]) -> Result<Vec<u32>, Fault> {
    let half = |x: u32| u32::from(f16::from_f32(f32::from_bits(x)).to_bits());
    Ok(match format {
        ImageFormat::R32Float | ImageFormat::R32Uint => vec![texel[0]],
        ImageFormat::Rgba32Float => texel.to_vec(),
        ImageFormat::Rgba16Float => vec![half(texel[0]) | half(texel[1]) << 16, half(texel[2]) | half(texel[3]) << 16],
        other => return Err(Fault::missing(format!("images of format {other}"))),
    })
}

/// Returns the word of a texel that has a component, and the component.
fn decode(format: ImageFormat, component: u32, word: impl FnOnce(u32) -> Result<u32, Fault>) -> Result<u32, Fault> {
    Ok(match format {
        ImageFormat::R32Float | ImageFormat::R32Uint => match component {
            0 => word(0)?,
            3 if format == ImageFormat::R32Float => 1.0_f32.to_bits(),
            3 => 1,
            _ => 0,
        },
        ImageFormat::Rgba32Float => word(component)?,
        ImageFormat::Rgba16Float => {
            let bits = word(component / 2)? >> (16 * (component % 2));
            f16::from_bits(bits as u16).to_f32().to_bits()
        }
        other => return Err(Fault::missing(format!("images of format {other}"))),
    })
}

impl Machine<'_> {
    /// Returns format and byte offset of a texel.
    fn texel_at(&self, binding: u32, x: u32, y: u32) -> Result<(ImageFormat, u32), Fault> {
        let ([width, height], format) =
            self.bindings[binding as usize].image.ok_or(Fault::Damaged("a buffer is bound as an image"))?;
        if x >= width || y >= height {
            let memory = self.code.binding_names[binding as usize].clone();
            return Err(Fault::Texel { memory, at: [x, y], size: [width, height] });
        }
        Ok((format, (y * width + x) * format.texel_bytes() as u32))
    }

    pub(super) fn texel<const N: usize>(
        &mut self,
        s: &mut Subgroup<N>,
        d: Slot,
        binding: u32,
        [x, y]: [Slot; 2],
        component: u32,
    ) -> Result<(), Fault> {
        let (x, y) = (at(&s.registers, x), at(&s.registers, y));
        let mut found = [0; N];
        for l in lanes(s.mask) {
            let (format, base) = self.texel_at(binding, x[l], y[l])?;
            found[l] = decode(format, component, |k| {
                let place = Place { space: Space::Buffer(binding), fixed: base + 4 * k, at: NONE };
                let word = self.word(s, &place, 0, l, Kind::Read)?;
                Ok(self.stores[self.bindings[binding as usize].store].get(word))
            })?;
        }
        s.put(d, found, s.mask);
        Ok(())
    }

    pub(super) fn set_texel<const N: usize>(
        &mut self,
        s: &Subgroup<N>,
        binding: u32,
        [x, y]: [Slot; 2],
        values: [Slot; 4],
    ) -> Result<(), Fault> {
        let (x, y) = (at(&s.registers, x), at(&s.registers, y));
        let values = values.map(|slot| at(&s.registers, slot));
        for l in lanes(s.mask) {
            let (format, base) = self.texel_at(binding, x[l], y[l])?;
            for (k, bits) in encode(format, values.map(|v| v[l]))?.into_iter().enumerate() {
                let place = Place { space: Space::Buffer(binding), fixed: base + 4 * k as u32, at: NONE };
                let word = self.word(s, &place, 0, l, Kind::Write)?;
                self.stores[self.bindings[binding as usize].store].set(word, bits);
            }
        }
        Ok(())
    }
}
