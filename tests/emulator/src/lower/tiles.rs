//! Cooperative matrices: loads, stores and products.

use super::{Lower, Scope, Value};
use crate::code::{Access, Slot, Space, Step};
use crate::fault::Fault;
use crate::module::{Inst, Tile, Type};
use crate::scalar::Un;
use spirv::Op;
use std::rc::Rc;

impl Lower<'_, '_> {
    /// Translates an instruction of cooperative matrices.
    pub(super) fn tiles(&mut self, scope: &mut Scope, inst: Inst<'_>) -> Result<(), Fault> {
        let args = inst.args;
        match inst.op {
            Op::CooperativeMatrixStoreKHR => {
                let tile = self.tile(scope, args[1])?;
                let first = self.block(scope, args[1])?[0];
                let access = self.access(scope, [args[0], args[2]], args.get(3), tile, first)?;
                self.step(Step::StoreTile(access));
            }
            Op::CooperativeMatrixLoadKHR => {
                let tile = self.module.tile_of(args[0]).ok_or(Fault::Damaged("a matrix has another type"))?;
                let found = self.slots(tile.share);
                let access = self.access(scope, [args[2], args[3]], args.get(4), tile, found[0])?;
                self.step(Step::LoadTile(access));
                scope.values.insert(args[1], Value::Registers(found));
            }
            _ => {
                let tile = self.module.tile_of(args[0]).ok_or(Fault::Damaged("a matrix has another type"))?;
                let found = self.slots(tile.share);
                let mut all = [(found[0], tile); 4];
                for (k, id) in args[2..5].iter().enumerate() {
                    all[k + 1] = (self.block(scope, *id)?[0], self.tile(scope, *id)?);
                }
                let [_, (_, left), (_, right), (_, addend)] = all;
                let fits = left.columns == right.rows && left.rows == tile.rows && right.columns == tile.columns;
                if !fits || addend != tile || [left.role, right.role, tile.role] != [0, 1, 2] {
                    return Err(Fault::Damaged("a product of matrices of other sizes"));
                }
                self.step(Step::MulAdd(all));
                scope.values.insert(args[1], Value::Registers(found));
            }
        }
        Ok(())
    }

    fn tile(&self, scope: &Scope, id: u32) -> Result<Tile, Fault> {
        self.module.tile_of(self.type_of(scope, id)?).ok_or(Fault::Damaged("a matrix has another type"))
    }

    /// Returns the registers of a value, one after the other.
    fn block(&mut self, scope: &Scope, id: u32) -> Result<Rc<[Slot]>, Fault> {
        let values = self.value(scope, id)?;
        let block = self.slots(values.len() as u32);
        for (to, from) in block.iter().zip(values.iter()) {
            self.step(Step::Un(Un::Copy, *to, *from));
        }
        Ok(block)
    }

    fn access(
        &mut self,
        scope: &Scope,
        [pointer, layout]: [u32; 2],
        stride: Option<&u32>,
        tile: Tile,
        first: Slot,
    ) -> Result<Access, Fault> {
        let pointer = self.pointer(scope, pointer)?;
        let scalar = matches!(self.module.ty(pointer.ty)?, Type::Float | Type::Half);
        if pointer.space != Space::Shared || !scalar {
            return Err(Fault::missing("cooperative matrices outside of shared scalars".to_owned()));
        }
        let by_columns = match self.module.scalar(layout)? {
            0 => false,
            1 => true,
            other => return Err(Fault::missing(format!("matrix layout {other}"))),
        };
        let stride = self.one(scope, *stride.ok_or(Fault::Damaged("a matrix has no stride"))?)?;
        Ok(Access { first, tile, place: self.places(&pointer)?[0], stride, by_columns })
    }
}
