//! Trainings of both stages, by the library and by `sgs`.

mod ablate;
mod ablate_materials;
mod bands;
mod batch;
mod datasets;
mod decided;
mod divergence;
mod evaluate;
mod interruptions;
mod intrinsic;
mod intrinsic_log;
mod meaning;
mod nan_priors;
mod quality;
mod region_sources;
mod relit_provider;
mod required;
mod robustness;
mod schedulers;
mod starts;
mod tiles;
mod traced_train;
mod train;
mod trainer;
mod transport_memory;
mod transport_stage;
