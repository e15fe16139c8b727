//! Workgroup size of a SPIR-V module with its specialization constants.

use crate::shader::instructions;

const OP_EXECUTION_MODE: u32 = 16;
const OP_EXECUTION_MODE_ID: u32 = 331;
const OP_CONSTANT: u32 = 43;
const OP_SPEC_CONSTANT: u32 = 50;
const OP_CONSTANT_COMPOSITE: u32 = 44;
const OP_SPEC_CONSTANT_COMPOSITE: u32 = 51;
const OP_DECORATE: u32 = 71;
const MODE_LOCAL_SIZE: u32 = 17;
const MODE_LOCAL_SIZE_ID: u32 = 38;
const DECORATION_SPEC_ID: u32 = 1;
const DECORATION_BUILT_IN: u32 = 11;
const BUILT_IN_WORKGROUP_SIZE: u32 = 25;

/// Returns the workgroup size along each axis; ones if the module does not declare it.
///
/// The built-in `WorkgroupSize` overrides the execution mode, as SPIR-V requires. `specs` holds constant ids and bits.
pub fn local_size(spirv: &[u32], specs: &[(u32, u32)]) -> [u32; 3] {
    let mut mode = [1; 3];
    let mut mode_ids = None;
    let mut built_in = None;
    let mut constant_ids = Vec::new();
    let mut values = Vec::new();
    let mut composites = Vec::new();
    for op in instructions(spirv) {
        match *op {
            [word, _, MODE_LOCAL_SIZE, x, y, z] if word & 0xffff == OP_EXECUTION_MODE => mode = [x, y, z],
            [word, _, MODE_LOCAL_SIZE_ID, x, y, z] if word & 0xffff == OP_EXECUTION_MODE_ID => {
                mode_ids = Some([x, y, z]);
            }
            [word, id, DECORATION_SPEC_ID, constant] if word & 0xffff == OP_DECORATE => {
                constant_ids.push((id, constant))
            }
            [word, id, DECORATION_BUILT_IN, BUILT_IN_WORKGROUP_SIZE] if word & 0xffff == OP_DECORATE => {
                built_in = Some(id);
            }
            [word, _, id, bits] if matches!(word & 0xffff, OP_CONSTANT | OP_SPEC_CONSTANT) => values.push((id, bits)),
            [word, _, id, x, y, z] if matches!(word & 0xffff, OP_CONSTANT_COMPOSITE | OP_SPEC_CONSTANT_COMPOSITE) => {
                composites.push((id, [x, y, z]));
            }
            _ => {}
        }
    }
    let find = |list: &[(u32, u32)], key: u32| list.iter().find(|(k, _)| *k == key).map(|(_, value)| *value);
    let value = |id: u32| {
        let specialized = find(&constant_ids, id).and_then(|constant| find(specs, constant));
        specialized.or_else(|| find(&values, id)).unwrap_or(1)
    };
    let composite = |id: u32| composites.iter().find(|(other, _)| *other == id).map(|(_, ids)| *ids);
    built_in.and_then(composite).or(mode_ids).map_or(mode, |ids| ids.map(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn op(code: u32, operands: &[u32]) -> Vec<u32> {
        [&[(operands.len() as u32 + 1) << 16 | code], operands].concat()
    }

    fn module(ops: &[Vec<u32>]) -> Vec<u32> {
        [vec![0x0723_0203, 0x0001_0600, 0, 99, 0], ops.concat()].concat()
    }

    #[test]
    fn literal_size_is_read() {
        let spirv = module(&[op(OP_EXECUTION_MODE, &[4, MODE_LOCAL_SIZE, 8, 4, 2])]);
        assert_eq!(local_size(&spirv, &[]), [8, 4, 2]);
        assert_eq!(local_size(&[], &[]), [1; 3]);
        assert_eq!(local_size(&spirv[..8], &[]), [1; 3], "a damaged module");
    }

    #[test]
    fn specialized_size_overrides_the_literal_one() {
        let ops = [
            op(OP_EXECUTION_MODE, &[4, MODE_LOCAL_SIZE, 1, 1, 1]),
            op(OP_DECORATE, &[10, DECORATION_SPEC_ID, 3]),
            op(OP_DECORATE, &[12, DECORATION_BUILT_IN, BUILT_IN_WORKGROUP_SIZE]),
            op(OP_SPEC_CONSTANT, &[6, 10, 256]),
            op(OP_CONSTANT, &[6, 11, 1]),
            op(OP_SPEC_CONSTANT_COMPOSITE, &[7, 12, 10, 11, 11]),
        ];
        assert_eq!(local_size(&module(&ops), &[]), [256, 1, 1]);
        assert_eq!(local_size(&module(&ops), &[(0, 7), (3, 64)]), [64, 1, 1]);
        let ids = [op(OP_EXECUTION_MODE_ID, &[4, MODE_LOCAL_SIZE_ID, 10, 11, 11]), ops[1].clone(), ops[3].clone()];
        assert_eq!(local_size(&module(&ids), &[(3, 32)]), [32, 1, 1]);
    }
}
