//! Compiled plans by declaration: building the same graph again costs a hash and a comparison.
//!
//! Owned by whoever wants one; nothing is shared behind anybody's back. A hit is exact: equal keys are not enough, the
//! declarations are compared.

use std::collections::HashMap;
use std::sync::Arc;

use super::builder::Graph;
use super::error::GraphError;
use super::plan::{self, CompileOptions, Plan};

/// Plans that were compiled lately.
#[derive(Debug)]
pub struct PlanCache {
    /// By key.
    plans: HashMap<u64, Entry>,
    capacity: usize,
    /// Counts uses, to find the one that was used longest ago.
    clock: u64,
    hits: u64,
    misses: u64,
}

#[derive(Debug)]
struct Entry {
    plan: Arc<Plan>,
    options: CompileOptions,
    used: u64,
}

impl PlanCache {
    /// A cache of at most `capacity` plans, at least one.
    pub fn new(capacity: usize) -> Self {
        PlanCache { plans: HashMap::new(), capacity: capacity.max(1), clock: 0, hits: 0, misses: 0 }
    }

    /// The plan of a graph: the one that an equal graph was given, or a new one.
    ///
    /// # Errors
    /// As [`Graph::compile`].
    pub fn compile(&mut self, graph: Graph, options: &CompileOptions) -> Result<Arc<Plan>, GraphError> {
        self.clock += 1;
        let key = graph.key(options);
        // Costs are part of the key alone: if two sets of them had the same, either plan would do.
        if let Some(entry) = self.plans.get_mut(&key)
            && graph.errors.is_empty()
            && graph.open.is_none()
            && entry.options == *options
            && same(&graph, &entry.plan)
        {
            entry.used = self.clock;
            self.hits += 1;
            return Ok(Arc::clone(&entry.plan));
        }
        self.misses += 1;
        let plan = Arc::new(graph.compile(options)?);
        if self.plans.len() >= self.capacity && !self.plans.contains_key(&key) {
            let oldest = self.plans.iter().min_by_key(|(_, entry)| entry.used).map(|(key, _)| *key);
            oldest.and_then(|oldest| self.plans.remove(&oldest));
        }
        self.plans.insert(key, Entry { plan: Arc::clone(&plan), options: *options, used: self.clock });
        Ok(plan)
    }

    /// How often a plan was there, and how often it was not.
    pub fn counts(&self) -> (u64, u64) {
        (self.hits, self.misses)
    }

    /// How many plans it holds.
    pub fn len(&self) -> usize {
        self.plans.len()
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.plans.is_empty()
    }

    /// Forgets every plan.
    pub fn clear(&mut self) {
        self.plans.clear();
    }
}

/// Whether a plan is of this declaration.
pub(super) fn same(graph: &Graph, plan: &Plan) -> bool {
    graph.name == plan.name && graph.buffers == plan.buffers && graph.passes == plan.passes
}

impl Graph {
    /// The key that a plan of this graph has.
    pub fn key(&self, options: &CompileOptions) -> u64 {
        plan::key(&self.name, &self.buffers, &self.passes, &self.costs, options)
    }
}
