//! Errors of providers. Each message is one sentence.

use crate::kind::Kind;

/// Failure of a provider.
///
/// Each message names the provider by its command. It also gives a remedy where that is not obvious.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProviderError {
    /// Invalid command line.
    #[error("the provider's command \"{command}\" {problem}; give one, as \"python3 -m sgs_priors stand-in=SCENE\"")]
    Command {
        /// Command line as given.
        command: String,
        /// Problem of the command line.
        problem: &'static str,
    },
    /// Program that does not exist or may not be run.
    #[error("the provider \"{command}\" cannot be started: {cause}")]
    Start {
        /// Command line.
        command: String,
        /// Reason reported by the system.
        cause: std::io::Error,
    },
    /// Provider that ended, or closed its output, before it answered.
    #[error("the provider \"{command}\" {how} before it answered {question}{}", last_words(.last))]
    Ended {
        /// Command line.
        command: String,
        /// Kind of end, as "ended with status 3".
        how: String,
        /// Pending question.
        question: &'static str,
        /// Last line on the standard error; may be empty.
        last: String,
    },
    /// Missing answer after the time limit. The program was killed.
    #[error(
        "the provider \"{command}\" gave no answer to {question} within {seconds} s and was stopped; allow more time, or \
         see what holds it up{}", last_words(.last)
    )]
    TimeOut {
        /// Command line.
        command: String,
        /// Pending question.
        question: &'static str,
        /// Time limit in seconds.
        seconds: f64,
        /// Last line on the standard error; may be empty.
        last: String,
    },
    /// Output that is not a valid answer. The program was killed.
    #[error("the provider \"{command}\" answered {question} with nonsense and was stopped: {what}")]
    Nonsense {
        /// Command line.
        command: String,
        /// Pending question.
        question: &'static str,
        /// Problem of the output.
        what: Nonsense,
    },
    /// Refused question. The provider stays ready for other questions.
    #[error("the provider \"{command}\" cannot answer {question}: {text}")]
    Refused {
        /// Command line.
        command: String,
        /// Refused question.
        question: &'static str,
        /// Reason given by the provider.
        text: String,
    },
    /// Question that the greeting did not offer. The provider stays ready for other questions.
    #[error("the provider \"{command}\" does not offer {question}; it offers {offers}")]
    NotOffered {
        /// Command line.
        command: String,
        /// Requested question.
        question: &'static str,
        /// Offered questions.
        offers: String,
    },
    /// Provider that was stopped after an earlier failure.
    #[error("the provider \"{command}\" has been stopped after an earlier failure")]
    Stopped {
        /// Command line.
        command: String,
    },
    /// Question that cannot be sent, for example because of its images.
    #[error("{question} cannot be asked: {problem}")]
    Question {
        /// Requested question.
        question: &'static str,
        /// Problem of the question.
        problem: String,
    },
}

/// Problem of a message from a provider.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Nonsense {
    /// Output that is not a message of the protocol, such as a print statement's.
    #[error("a message begins with \"SGSP\", but there was \"{0}\"; nothing else may go to its standard output")]
    Magic(String),
    /// Message length over the limit.
    #[error("a message of {length} bytes is announced, but at most {limit} are taken")]
    Length {
        /// Announced length in bytes.
        length: u64,
        /// Limit in bytes.
        limit: u64,
    },
    /// Payload that is not a valid safetensors file.
    #[error("the message is no safetensors file ({0})")]
    Payload(String),
    /// JSON text that is absent or invalid.
    #[error("the message's text {0}")]
    Text(String),
    /// Unsupported version of the protocol.
    #[error("it speaks version {theirs} of the protocol, but {} to {} are spoken here", crate::VERSIONS[0], crate::VERSIONS[1])]
    Version {
        /// Version chosen by the provider.
        theirs: u64,
    },
    /// Field of the text that is absent or has a wrong type.
    #[error("the field \"{name}\" must be {expected}, but is {found}")]
    Field {
        /// Name of the field.
        name: &'static str,
        /// Expected value.
        expected: String,
        /// Found value as JSON, shortened.
        found: String,
    },
    /// Missing array.
    #[error("the array \"{name}\" is missing; there is {there}")]
    Missing {
        /// Name of the array.
        name: String,
        /// Names of the existing arrays.
        there: String,
    },
    /// Array with a wrong number type.
    #[error("the array \"{name}\" holds {found}, but must hold {expected}")]
    Type {
        /// Name of the array.
        name: String,
        /// Found type.
        found: String,
        /// Expected type.
        expected: Kind,
    },
    /// Array with a wrong shape.
    #[error("the array \"{name}\" has the shape {found:?}, but must have {expected}")]
    Shape {
        /// Name of the array.
        name: String,
        /// Found shape.
        found: Vec<usize>,
        /// Expected shape.
        expected: String,
    },
    /// Array with a value outside its range.
    #[error("the array \"{name}\" holds {value} at index {index}, but must hold {expected}")]
    Value {
        /// Name of the array.
        name: String,
        /// Found value.
        value: f64,
        /// Index in the flat array.
        index: usize,
        /// Expected values.
        expected: &'static str,
    },
}

/// Result of provider operations.
pub type Result<T, E = ProviderError> = std::result::Result<T, E>;

fn last_words(last: &str) -> String {
    if last.is_empty() { String::new() } else { format!("; its last words: {last}") }
}
