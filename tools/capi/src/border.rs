//! Conversion between C and Rust: structs by their size, strings, error texts, and panics.
//!
//! Guarantees: missing fields of a struct of an older program are zero. A struct of a newer program is accepted if its
//! unknown fields are zero. No byte beyond the size that the caller states is read or written. The callers interpret
//! the values.

use crate::types::SgsResult;
use std::ffi::{CStr, c_char};
use std::mem::MaybeUninit;

/// Failure of a call: code and one sentence.
#[derive(Debug, thiserror::Error)]
#[error("{text}")]
pub struct Failure {
    /// Result code for the program.
    pub code: SgsResult,
    /// Sentence for people.
    pub text: String,
}

/// Result of all functions behind the C interface.
pub type Outcome<T> = Result<T, Failure>;

/// Returns a failure with a sentence.
pub fn fail<T>(code: SgsResult, text: impl Into<String>) -> Outcome<T> {
    Err(Failure { code, text: text.into() })
}

impl From<sgs_engine::Error> for Failure {
    fn from(error: sgs_engine::Error) -> Failure {
        use sgs_engine::Error as E;
        let code = match &error {
            E::Loader(_) | E::NoDevice { .. } | E::MissingFeatures { .. } | E::NoValidation | E::Host(_) => {
                SgsResult::SGS_ERROR_DEVICE
            }
            E::NoQueue(_) | E::MissingExtension { .. } | E::BindingTooLarge { .. } => SgsResult::SGS_ERROR_DEVICE,
            E::DeviceLost(_) => SgsResult::SGS_ERROR_LOST,
            E::OutOfMemory { .. } | E::OverBudget { .. } => SgsResult::SGS_ERROR_MEMORY,
            E::SlotsInUse { .. } | E::Timeout { .. } => SgsResult::SGS_ERROR_BUSY,
            E::ImageSize { .. } | E::OutOfRange { .. } => SgsResult::SGS_ERROR_ARGUMENT,
            E::Vulkan { result, .. } if out_of_memory(*result) => SgsResult::SGS_ERROR_MEMORY,
            _ => SgsResult::SGS_ERROR_DEVICE,
        };
        Failure { code, text: error.to_string() }
    }
}

fn out_of_memory(result: sgs_engine::vk::Result) -> bool {
    use sgs_engine::vk::Result as R;
    matches!(result, R::ERROR_OUT_OF_HOST_MEMORY | R::ERROR_OUT_OF_DEVICE_MEMORY)
}

impl From<sgs_scene::SceneError> for Failure {
    fn from(error: sgs_scene::SceneError) -> Failure {
        Failure { code: SgsResult::SGS_ERROR_FILE, text: error.to_string() }
    }
}

impl From<sgs_train::TrainError> for Failure {
    fn from(error: sgs_train::TrainError) -> Failure {
        use sgs_train::TrainError as E;
        match error {
            E::Engine(error) => error.into(),
            E::Scene(error) => error.into(),
            E::Run(error) => error.into(),
            E::Config(error) => error.into(),
            E::Requirement(e) => Failure { code: SgsResult::SGS_ERROR_ARGUMENT, text: e.to_string() },
            E::File { .. } => Failure { code: SgsResult::SGS_ERROR_FILE, text: error.to_string() },
            _ => Failure { code: SgsResult::SGS_ERROR_TRAINING, text: error.to_string() },
        }
    }
}

impl From<sgs_config::ConfigError> for Failure {
    fn from(error: sgs_config::ConfigError) -> Failure {
        Failure { code: SgsResult::SGS_ERROR_ARGUMENT, text: error.to_string() }
    }
}

impl From<sgs_run::RunError> for Failure {
    fn from(error: sgs_run::RunError) -> Failure {
        use sgs_run::RunError as E;
        match error {
            E::Engine(error) => error.into(),
            E::Scene(error) => error.into(),
            E::Config(error) => error.into(),
            E::Refused(text) => Failure { code: SgsResult::SGS_ERROR_ARGUMENT, text },
            E::File { .. } | E::Io { .. } | E::Locked { .. } => {
                Failure { code: SgsResult::SGS_ERROR_FILE, text: error.to_string() }
            }
        }
    }
}

impl From<sgs_relight::RelightError> for Failure {
    fn from(error: sgs_relight::RelightError) -> Failure {
        use sgs_relight::RelightError as E;
        match error {
            E::Engine(error) => error.into(),
            E::Scene(error) => error.into(),
            E::Run(error) => error.into(),
            E::Config(error) => error.into(),
            E::Train(error) => error.into(),
            E::Edit(text) => Failure { code: SgsResult::SGS_ERROR_ARGUMENT, text },
            E::File { .. } => Failure { code: SgsResult::SGS_ERROR_FILE, text: error.to_string() },
            E::Evaluate(_) | E::Metric(_) | E::Transport(_) => {
                Failure { code: SgsResult::SGS_ERROR_ARGUMENT, text: error.to_string() }
            }
        }
    }
}

impl From<sgs_passes::pipeline::ViewError> for Failure {
    fn from(error: sgs_passes::pipeline::ViewError) -> Failure {
        match error {
            sgs_passes::pipeline::ViewError::Engine(error) => error.into(),
            _ => Failure { code: SgsResult::SGS_ERROR_ARGUMENT, text: error.to_string() },
        }
    }
}

/// Struct of `sgs.h`: plain data that begins with `struct_size: u32` and is valid with all bits zero.
///
/// # Safety
/// Both properties must hold.
pub unsafe trait Struct: Copy {
    /// Name of the struct.
    const NAME: &'static str;
    /// Size in the first version of the interface.
    const FIRST: usize;
}

macro_rules! structs {
    ($($name:ident),*) => {$(
        // SAFETY: the struct is `repr(C)` with `struct_size` first, of integers, floats, raw pointers and optional
        // functions, for all of which zero is a value.
        unsafe impl Struct for crate::types::$name {
            const NAME: &'static str = stringify!($name);
            const FIRST: usize = size_of::<crate::types::$name>();
        }
    )*};
}

structs!(
    SgsInstance,
    SgsRequirementsInfo,
    SgsDeviceInfo,
    SgsHostDevice,
    SgsContextInfo,
    SgsSceneInfo,
    SgsCamera,
    SgsRenderInfo,
    SgsViewInfo,
    SgsFrame,
    SgsViewReport,
    SgsRelightInfo,
    SgsRelightState,
    SgsEmitter,
    SgsLight,
    SgsNewLight,
    SgsRelitInfo,
    SgsTrainerInfo,
    SgsTrainStatus
);

/// Returns the stated size of a struct, if it is plausible.
///
/// # Safety
/// `from` is null or points to a struct of which the first four bytes can be read.
unsafe fn stated<T: Struct>(from: *const T) -> Outcome<usize> {
    if from.is_null() {
        return fail(SgsResult::SGS_ERROR_NULL, format!("{} is null.", T::NAME));
    }
    // SAFETY: not null, so the size can be read by the caller's contract; it need not be aligned.
    let size = unsafe { from.cast::<u32>().read_unaligned() } as usize;
    if !(T::FIRST..=1 << 16).contains(&size) {
        let text = format!("{}.struct_size is {size}, but must be sizeof({}), {}.", T::NAME, T::NAME, size_of::<T>());
        return fail(SgsResult::SGS_ERROR_STRUCT_SIZE, text);
    }
    Ok(size)
}

/// Copies a caller's struct.
///
/// # Safety
/// `from` is null or points to as many readable bytes as its `struct_size` says, and to at least four.
pub unsafe fn read<T: Struct>(from: *const T) -> Outcome<T> {
    // SAFETY: by the caller's contract.
    let size = unsafe { stated(from) }?;
    let mut copy = MaybeUninit::<T>::zeroed();
    let known = size.min(size_of::<T>());
    // SAFETY: `known` bytes can be read by the caller's contract, and fit.
    unsafe { std::ptr::copy_nonoverlapping(from.cast::<u8>(), copy.as_mut_ptr().cast::<u8>(), known) };
    for at in known..size {
        // SAFETY: inside the stated size.
        if unsafe { from.cast::<u8>().add(at).read() } != 0 {
            let text = format!("{} uses fields that this version of the library does not know.", T::NAME);
            return fail(SgsResult::SGS_ERROR_STRUCT_SIZE, text);
        }
    }
    // SAFETY: zero is a value of every field, and so is whatever a C program has put there.
    Ok(unsafe { copy.assume_init() })
}

/// Fills a caller's struct, all but its size.
///
/// # Safety
/// `into` is null or points to as many writable bytes as its `struct_size` says, and to at least four.
pub unsafe fn write<T: Struct>(into: *mut T, value: &T) -> Outcome<()> {
    // SAFETY: by the caller's contract.
    let size = unsafe { stated(into) }?;
    let known = size.min(size_of::<T>());
    let skip = size_of::<u32>();
    // SAFETY: `known` bytes can be written by the caller's contract; the first four stay.
    unsafe {
        let from = std::ptr::from_ref(value).cast::<u8>().add(skip);
        std::ptr::copy_nonoverlapping(from, into.cast::<u8>().add(skip), known - skip);
    }
    Ok(())
}

/// Copies a required string.
///
/// # Safety
/// `from` is null or a string that ends with a zero.
pub unsafe fn string(from: *const c_char, what: &str) -> Outcome<String> {
    // SAFETY: by the caller's contract.
    match unsafe { optional_string(from, what) }? {
        Some(text) => Ok(text),
        None => fail(SgsResult::SGS_ERROR_NULL, format!("{what} is null.")),
    }
}

/// Copies a string that may be null.
///
/// # Safety
/// As for [`string`].
pub unsafe fn optional_string(from: *const c_char, what: &str) -> Outcome<Option<String>> {
    if from.is_null() {
        return Ok(None);
    }
    // SAFETY: by the caller's contract.
    match unsafe { CStr::from_ptr(from) }.to_str() {
        Ok(text) => Ok(Some(text.to_owned())),
        Err(_) => fail(SgsResult::SGS_ERROR_ARGUMENT, format!("{what} is not UTF-8.")),
    }
}

/// Borrows an array of strings. `count`: number of strings.
///
/// # Safety
/// `from` points to `count` strings that end with zeros, or `count` is 0.
pub unsafe fn strings<'a>(from: *const *const c_char, count: u32, what: &str) -> Outcome<Vec<&'a CStr>> {
    if count == 0 {
        return Ok(Vec::new());
    }
    if from.is_null() || count > 1 << 16 {
        return fail(SgsResult::SGS_ERROR_NULL, format!("{what} is null, or {count} is too many."));
    }
    let mut all = Vec::with_capacity(count as usize);
    for i in 0..count as usize {
        // SAFETY: inside the array by the caller's contract.
        let one = unsafe { from.add(i).read() };
        if one.is_null() {
            return fail(SgsResult::SGS_ERROR_NULL, format!("{what}[{i}] is null."));
        }
        // SAFETY: a string by the caller's contract.
        all.push(unsafe { CStr::from_ptr(one) });
    }
    Ok(all)
}

/// Writes as much of a text as fits, with a terminating zero.
///
/// # Safety
/// `into` is null or has space for `size` bytes.
pub unsafe fn put_text(into: *mut c_char, size: usize, text: &str) {
    if into.is_null() || size == 0 {
        return;
    }
    let mut fits = text.len().min(size - 1);
    while !text.is_char_boundary(fits) {
        fits -= 1;
    }
    // SAFETY: `fits` and the zero are within `size`.
    unsafe {
        std::ptr::copy_nonoverlapping(text.as_ptr(), into.cast::<u8>(), fits);
        into.add(fits).write(0);
    }
}

/// Runs a function that may fail or panic. A panic becomes a failure; nothing unwinds out of it.
pub fn guarded<T>(run: impl FnOnce() -> Outcome<T>) -> Outcome<T> {
    match std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)) {
        Ok(outcome) => outcome,
        Err(panic) => {
            let text = panic.downcast_ref::<&str>().copied().map(str::to_owned);
            let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
            fail(SgsResult::SGS_ERROR_INTERNAL, format!("A defect of the library: {text}."))
        }
    }
}
