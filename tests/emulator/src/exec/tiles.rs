//! Cooperative matrices of a subgroup.

use super::subgroup::Subgroup;
use super::{Machine, at, offset};
use crate::code::{Access, Slot};
use crate::fault::Fault;
use crate::memory::Kind;
use crate::module::Tile;

/// Fails unless all lanes are active.
fn converged<const N: usize>(s: &Subgroup<N>) -> Result<(), Fault> {
    if s.mask == Subgroup::<N>::FULL {
        return Ok(());
    }
    Err(Fault::Barrier(format!("lanes {:#x} of subgroup {} multiply cooperative matrices", s.mask, s.number)))
}

/// Returns the elements of a matrix, row by row.
fn elements<const N: usize>(s: &Subgroup<N>, (first, tile): (Slot, Tile)) -> Vec<f32> {
    let mut found = vec![0.0; (tile.rows * tile.columns) as usize];
    for index in 0..tile.share {
        let register = at(&s.registers, first + index);
        for (lane, bits) in register.iter().enumerate() {
            let (row, column) = tile.place(lane as u32, index);
            found[(row * tile.columns + column) as usize] = f32::from_bits(*bits);
        }
    }
    found
}

/// Computes left * right + addend.
pub(super) fn multiply<const N: usize>(s: &mut Subgroup<N>, all: [(Slot, Tile); 4]) -> Result<(), Fault> {
    converged(s)?;
    let [(to, tile), left, right, addend] = all;
    let depth = left.1.columns;
    let [left, right, addend] = [left, right, addend].map(|operand| elements(s, operand));
    for index in 0..tile.share {
        s.registers[(to + index) as usize] = std::array::from_fn(|lane| {
            let (row, column) = tile.place(lane as u32, index);
            let product = |sum: f32, k: u32| {
                left[(row * depth + k) as usize].mul_add(right[(k * tile.columns + column) as usize], sum)
            };
            (0..depth).fold(addend[(row * tile.columns + column) as usize], product).to_bits()
        });
    }
    Ok(())
}

impl Machine<'_> {
    /// Loads or stores a matrix in shared memory.
    pub(super) fn tile<const N: usize>(
        &mut self,
        s: &mut Subgroup<N>,
        access: &Access,
        kind: Kind,
    ) -> Result<(), Fault> {
        converged(s)?;
        let (from, stride) = (offset(&s.registers, access.place.at), at(&s.registers, access.stride));
        if (1..N).any(|lane| from[lane] != from[0] || stride[lane] != stride[0]) {
            return Err(Fault::Barrier("lanes name different cooperative matrices".to_owned()));
        }
        for index in 0..access.tile.share {
            let slot = (access.first + index) as usize;
            for lane in 0..N {
                let (row, column) = access.tile.place(lane as u32, index);
                let (line, along) = if access.by_columns { (column, row) } else { (row, column) };
                let word = self.word(s, &access.place, from[0] + line * stride[0] + along, lane, kind)?;
                if kind == Kind::Write {
                    self.shared.set(word, s.registers[slot][lane]);
                } else {
                    s.registers[slot][lane] = self.shared.get(word);
                }
            }
        }
        Ok(())
    }
}
