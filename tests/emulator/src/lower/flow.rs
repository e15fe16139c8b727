//! Functions and control flow.

use super::{Lower, Scope, Value};
use crate::code::{Edge, End, Slot, Step};
use crate::fault::Fault;
use crate::module::{Function, Inst, Type};
use crate::scalar::Un;
use spirv::Op;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;

impl<'w> Lower<'_, 'w> {
    /// Returns the blocks that a terminator leads to. Constant conditions lead to one.
    fn successors(&self, inst: &Inst<'_>) -> Vec<u32> {
        let args = inst.args;
        let constant = |id: u32| self.module.constants.get(&id).map(|bits| bits[0]);
        match inst.op {
            Op::Branch => vec![args[0]],
            Op::BranchConditional => match constant(args[0]) {
                Some(0) => vec![args[2]],
                Some(_) => vec![args[1]],
                None => vec![args[1], args[2]],
            },
            Op::Switch => [args[1]].into_iter().chain(args[2..].chunks(2).map(|c| c[1])).collect(),
            _ => Vec::new(),
        }
    }

    /// Returns the reachable blocks. Fails if their order does not let diverged lanes meet at merge blocks.
    fn reachable(&self, function: &Function<'w>) -> Result<HashSet<u32>, Fault> {
        let place: HashMap<u32, usize> = function.blocks.iter().enumerate().map(|(i, b)| (b.label, i)).collect();
        let mut found = HashSet::new();
        let mut next = vec![0];
        // Continue block of each loop, by its header.
        let mut continues = HashMap::new();
        for (i, block) in function.blocks.iter().enumerate() {
            for inst in &block.insts {
                let merges = match inst.op {
                    Op::LoopMerge => &inst.args[..2],
                    Op::SelectionMerge => &inst.args[..1],
                    _ => continue,
                };
                if merges.iter().any(|m| place.get(m).is_none_or(|p| *p < i)) || place[&merges[0]] <= i {
                    return Err(Fault::missing("a merge block before its header".to_owned()));
                }
                if inst.op == Op::LoopMerge {
                    if merges[0] == merges[1] || place[&merges[1]] >= place[&merges[0]] {
                        return Err(Fault::missing("a continue block after its loop".to_owned()));
                    }
                    continues.insert(i, place[&merges[1]]);
                }
            }
        }
        while let Some(i) = next.pop() {
            let block = &function.blocks[i];
            if !found.insert(block.label) {
                continue;
            }
            let end = block.insts.last().ok_or(Fault::Damaged("a block is empty"))?;
            for label in self.successors(end) {
                let to = *place.get(&label).ok_or(Fault::Damaged("a block is unknown"))?;
                if to <= i && continues.get(&to).is_none_or(|c| i < *c) {
                    return Err(Fault::missing("a branch back that is no loop".to_owned()));
                }
                next.push(to);
            }
        }
        Ok(found)
    }

    /// Inlines a function. Returns the registers of its result.
    pub(super) fn inline(&mut self, id: u32, arguments: Vec<Value>, entry: bool) -> Result<Rc<[Slot]>, Fault> {
        let module = self.module;
        let function = module.functions.get(&id).ok_or(Fault::Damaged("a function is unknown"))?;
        let reachable = self.reachable(function)?;
        let mut scope = Scope::default();
        scope.values.extend(function.parameters.iter().copied().zip(arguments));
        let blocks: Vec<_> = function.blocks.iter().filter(|b| reachable.contains(&b.label)).collect();
        let returns: Vec<_> = blocks
            .iter()
            .filter_map(|b| {
                b.insts.last().filter(|i| matches!(i.op, Op::Return | Op::ReturnValue)).map(|i| (b.label, *i))
            })
            .collect();
        // A single return at the end needs no branch.
        let straight = !entry && returns.len() == 1 && blocks.last().is_some_and(|b| b.label == returns[0].0);
        if !entry && !straight {
            let count = module.flat(function.result)?;
            scope.back = Some((self.label(), self.variable(count)));
        }
        for (k, block) in blocks.iter().enumerate() {
            scope.block = block.label;
            if k > 0 {
                let label = self.block_label(&mut scope, block.label);
                self.begin(label);
            }
            for inst in &block.insts {
                match inst.op {
                    Op::Return if straight => return Ok(Rc::from([])),
                    Op::ReturnValue if straight => return self.value(&scope, inst.args[0]),
                    _ => self.inst(&mut scope, *inst).map_err(|f| match module.names.get(&id) {
                        Some(name) if !matches!(f, Fault::In(..)) => f.within(&format!("function {name}")),
                        _ => f,
                    })?,
                }
            }
        }
        match scope.back.take() {
            Some((label, result)) => {
                self.begin(label);
                Ok(result)
            }
            None => Ok(Rc::from([])),
        }
    }

    fn block_label(&mut self, scope: &mut Scope, block: u32) -> u32 {
        if let Some(label) = scope.labels.get(&block) {
            return *label;
        }
        let label = self.label();
        scope.labels.insert(block, label);
        label
    }

    /// Returns the way to a block, with the copies into its phis.
    fn edge(&mut self, scope: &mut Scope, function_block: u32) -> Result<Edge, Fault> {
        let target = self.block_label(scope, function_block);
        let module = self.module;
        let (function, place) = module.labels.get(&function_block).ok_or(Fault::Damaged("a block is unknown"))?;
        let block = &module.functions[function].blocks[*place];
        let mut copies = Vec::new();
        for phi in block.insts.iter().take_while(|i| i.op == Op::Phi) {
            let to = self.phi(scope, phi)?;
            let from = phi.args[2..].chunks(2).find(|pair| pair[1] == scope.block);
            let from = from.ok_or(Fault::Damaged("a phi lacks a block"))?[0];
            let from = self.value(scope, from)?;
            copies.extend(to.iter().copied().zip(from.iter().copied()));
        }
        Ok(Edge { target, copies })
    }

    fn phi(&mut self, scope: &mut Scope, phi: &Inst<'_>) -> Result<Rc<[Slot]>, Fault> {
        let id = phi.args[1];
        if let Some(slots) = scope.phis.get(&id) {
            return Ok(slots.clone());
        }
        let count = self.module.flat(phi.args[0])?;
        let slots = self.variable(count);
        scope.phis.insert(id, slots.clone());
        scope.values.insert(id, Value::Registers(slots.clone()));
        Ok(slots)
    }

    /// Translates control flow. Returns false for other instructions.
    pub(super) fn flow(&mut self, scope: &mut Scope, inst: Inst<'_>) -> Result<bool, Fault> {
        let args = inst.args;
        match inst.op {
            Op::SelectionMerge | Op::LoopMerge => {}
            Op::Phi => {
                self.phi(scope, &inst)?;
            }
            Op::Branch => {
                let edge = self.edge(scope, args[0])?;
                self.close(End::Jump(edge));
            }
            Op::BranchConditional => {
                let ways = self.successors(&inst);
                if let [only] = ways[..] {
                    let edge = self.edge(scope, only)?;
                    self.close(End::Jump(edge));
                } else {
                    let condition = self.one(scope, args[0])?;
                    let (yes, no) = (self.edge(scope, ways[0])?, self.edge(scope, ways[1])?);
                    self.close(End::Branch(condition, yes, no));
                }
            }
            Op::Switch => {
                let selector = self.one(scope, args[0])?;
                let other = self.edge(scope, args[1])?;
                let mut cases = Vec::new();
                for case in args[2..].chunks(2) {
                    cases.push((case[0], self.edge(scope, case[1])?));
                }
                self.close(End::Switch(selector, cases, other));
            }
            Op::Return | Op::ReturnValue => match scope.back.clone() {
                Some((label, result)) => {
                    if inst.op == Op::ReturnValue {
                        let value = self.value(scope, args[0])?;
                        for (to, from) in result.iter().zip(value.iter()) {
                            self.step(Step::Un(Un::Copy, *to, *from));
                        }
                    }
                    self.close(End::Jump(Edge { target: label, copies: Vec::new() }));
                }
                None => self.close(End::Exit),
            },
            Op::Unreachable => self.close(End::Unreachable),
            Op::FunctionCall => {
                let mut arguments = Vec::new();
                for id in &args[3..] {
                    let image = self.image(scope, *id);
                    arguments.push(match (image, self.pointer(scope, *id)) {
                        (Some(binding), _) => Value::Image(binding),
                        (None, Ok(pointer)) => Value::Pointer(pointer),
                        (None, Err(_)) => Value::Registers(self.value(scope, *id)?),
                    });
                }
                let result = self.inline(args[2], arguments, false)?;
                if !matches!(self.module.ty(args[0])?, Type::Void) {
                    scope.values.insert(args[1], Value::Registers(result));
                }
            }
            _ => return Ok(false),
        }
        Ok(true)
    }
}
