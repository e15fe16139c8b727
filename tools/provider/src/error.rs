//! What a provider can do wrong, in one sentence each.

use crate::kind::Kind;

/// Why a provider gave no usable answer. Each message names the provider by its command, and what to do where that is
/// not obvious.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProviderError {
    /// The command is no command.
    #[error("the provider's command \"{command}\" {problem}; give one, as \"python3 -m sgs_priors stand-in=SCENE\"")]
    Command {
        /// The command line as given.
        command: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// The program does not exist or may not be run.
    #[error("the provider \"{command}\" cannot be started: {cause}")]
    Start {
        /// Its command line.
        command: String,
        /// The system's answer.
        cause: std::io::Error,
    },
    /// The program ended, or closed its output, while an answer was awaited.
    #[error("the provider \"{command}\" {how} before it answered {question}{}", last_words(.last))]
    Ended {
        /// Its command line.
        command: String,
        /// How it ended, as "ended with status 3".
        how: String,
        /// What was asked.
        question: &'static str,
        /// The last line that it wrote to its standard error; may be empty.
        last: String,
    },
    /// No answer came in time; the program was killed.
    #[error(
        "the provider \"{command}\" gave no answer to {question} within {seconds} s and was stopped; allow more time, or \
         see what holds it up{}", last_words(.last)
    )]
    TimeOut {
        /// Its command line.
        command: String,
        /// What was asked.
        question: &'static str,
        /// The limit.
        seconds: f64,
        /// The last line that it wrote to its standard error; may be empty.
        last: String,
    },
    /// What it wrote is not an answer; the program was killed.
    #[error("the provider \"{command}\" answered {question} with nonsense and was stopped: {what}")]
    Nonsense {
        /// Its command line.
        command: String,
        /// What was asked.
        question: &'static str,
        /// What is wrong.
        what: Nonsense,
    },
    /// It says that it cannot answer. It stays ready for other questions.
    #[error("the provider \"{command}\" cannot answer {question}: {text}")]
    Refused {
        /// Its command line.
        command: String,
        /// What was asked.
        question: &'static str,
        /// Its own words.
        text: String,
    },
    /// It never said that it could. It stays ready for other questions.
    #[error("the provider \"{command}\" does not offer {question}; it offers {offers}")]
    NotOffered {
        /// Its command line.
        command: String,
        /// What was asked.
        question: &'static str,
        /// What it offers.
        offers: String,
    },
    /// It was stopped after an earlier failure.
    #[error("the provider \"{command}\" has been stopped after an earlier failure")]
    Stopped {
        /// Its command line.
        command: String,
    },
    /// The caller's images cannot be sent.
    #[error("{question} cannot be asked: {problem}")]
    Question {
        /// What was to be asked.
        question: &'static str,
        /// What is wrong.
        problem: String,
    },
}

/// What is wrong with something a provider wrote.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Nonsense {
    /// Something else than a message of the protocol, as a print statement leaves it.
    #[error("a message begins with \"SGSP\", but there was \"{0}\"; nothing else may go to its standard output")]
    Magic(String),
    /// A length that nobody could mean.
    #[error("a message of {length} bytes is announced, but at most {limit} are taken")]
    Length {
        /// The announced length.
        length: u64,
        /// The limit.
        limit: u64,
    },
    /// The payload is no safetensors file.
    #[error("the message is no safetensors file ({0})")]
    Payload(String),
    /// The message's own text is absent or not JSON.
    #[error("the message's text {0}")]
    Text(String),
    /// A version that is not spoken here.
    #[error("it speaks version {theirs} of the protocol, but {} to {} are spoken here", crate::VERSIONS[0], crate::VERSIONS[1])]
    Version {
        /// The version that it chose.
        theirs: u64,
    },
    /// A field of the text is absent or of the wrong kind.
    #[error("the field \"{name}\" must be {expected}, but is {found}")]
    Field {
        /// The field.
        name: &'static str,
        /// What it should be.
        expected: String,
        /// What it is, as JSON, shortened.
        found: String,
    },
    /// An array is absent.
    #[error("the array \"{name}\" is missing; there is {there}")]
    Missing {
        /// The array.
        name: String,
        /// Which arrays there are.
        there: String,
    },
    /// An array holds other numbers than it should.
    #[error("the array \"{name}\" holds {found}, but must hold {expected}")]
    Type {
        /// The array.
        name: String,
        /// What it holds.
        found: String,
        /// What it must hold.
        expected: Kind,
    },
    /// An array has another shape than it should.
    #[error("the array \"{name}\" has the shape {found:?}, but must have {expected}")]
    Shape {
        /// The array.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The shape it must have.
        expected: String,
    },
    /// A number that must not occur.
    #[error("the array \"{name}\" holds {value} at index {index}, but must hold {expected}")]
    Value {
        /// The array.
        name: String,
        /// The number.
        value: f64,
        /// Its place in the flat array.
        index: usize,
        /// What it must hold.
        expected: &'static str,
    },
}

/// The result of everything that asks a provider.
pub type Result<T, E = ProviderError> = std::result::Result<T, E>;

fn last_words(last: &str) -> String {
    if last.is_empty() { String::new() } else { format!("; its last words: {last}") }
}
