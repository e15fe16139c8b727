//! Optional provider.

use crate::error::Result;
use crate::options::ProviderOptions;
use crate::provider::Provider;
use serde::{Deserialize, Serialize};

/// Reaction to the failure of a provider.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fallback {
    /// Returns the error to the caller.
    #[default]
    Stop,
    /// Logs the failure once and continues without a provider.
    GoOn,
}

/// Provider that may be absent after a failure.
pub struct Helper {
    provider: Option<Provider>,
    fallback: Fallback,
}

impl Helper {
    /// Starts a provider.
    ///
    /// # Errors
    /// Those of [`Provider::start`], unless the fallback is to continue without it.
    pub fn start(options: &ProviderOptions, fallback: Fallback) -> Result<Helper> {
        let mut helper = Helper { provider: None, fallback };
        helper.provider = helper.settle(Provider::start(options))?;
        Ok(helper)
    }

    /// Returns true if the provider is still available.
    pub fn is_there(&self) -> bool {
        self.provider.is_some()
    }

    /// Asks a question. Returns `None` if the provider failed now or before.
    ///
    /// Every failure counts, refusals too: an intermittent loss term would be worse than none.
    ///
    /// # Errors
    /// Those of the question, if the fallback is to stop.
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
