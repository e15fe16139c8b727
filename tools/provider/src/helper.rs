//! A provider that a caller can do without.

use crate::error::Result;
use crate::options::ProviderOptions;
use crate::provider::Provider;
use serde::{Deserialize, Serialize};

/// What to do when a provider fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fallback {
    /// The failure is the caller's.
    #[default]
    Stop,
    /// The failure is said once, and then there is no provider.
    GoOn,
}

/// A provider, or none any more.
pub struct Helper {
    provider: Option<Provider>,
    fallback: Fallback,
}

impl Helper {
    /// Starts a provider.
    ///
    /// # Errors
    /// Those of [`Provider::start`], unless the caller goes on without.
    pub fn start(options: &ProviderOptions, fallback: Fallback) -> Result<Helper> {
        let mut helper = Helper { provider: None, fallback };
        helper.provider = helper.settle(Provider::start(options))?;
        Ok(helper)
    }

    /// Whether there is still someone to ask.
    pub fn is_there(&self) -> bool {
        self.provider.is_some()
    }

    /// Asks; `None` if the provider has failed, now or before, and the caller goes on without. Any failure counts,
    /// refusals too: a term of a loss that comes and goes would be worse than none.
    ///
    /// # Errors
    /// Those of the question, if the caller wants to stop.
    pub fn ask<T>(&mut self, question: impl FnOnce(&mut Provider) -> Result<T>) -> Result<Option<T>> {
        let Some(provider) = &mut self.provider else { return Ok(None) };
        let answer = question(provider);
        let answer = self.settle(answer)?;
        if answer.is_none() {
            self.provider = None;
        }
        Ok(answer)
    }

    fn settle<T>(&self, result: Result<T>) -> Result<Option<T>> {
        match (result, self.fallback) {
            (Ok(value), _) => Ok(Some(value)),
            (Err(error), Fallback::Stop) => Err(error),
            (Err(error), Fallback::GoOn) => {
                tracing::warn!("{error}; going on without it");
                Ok(None)
            }
        }
    }
}
