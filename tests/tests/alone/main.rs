//! Tests that open and close devices with validation, one at a time: faults, limits, budgets, planted
//! hazards, and pipelines of a device without earlier ones.
//!
//! `sgs_tests::turn` says why they are not in the programs `device` and `training`.

mod faults;
mod intrinsic_memory;
mod limits;
mod memory;
mod planning;
mod planted_barriers;
mod side_by_side;
mod subgroups;
mod train_faults;
mod uploads;
