//! Options, which are set by their keys: settings of the library, resources of the machine, and the
//! frames to convert.

use std::ffi::{CString, c_char, c_void};
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::ptr::null;
use std::sync::LazyLock;

use bytesize::ByteSize;
use meniscus::devices::{DeviceChoice, bytes_of, device, fastest};
use meniscus::files::Replace;
use meniscus::{
    Cancel, Error, MemoryBudget, Reconstruction, Setting, Settings, Simulation, Source,
    default_memory,
};

use crate::control::{Control, Listener, MeniscusCancel, MeniscusProgressCallback, free};
use crate::conversion::{EventListener, MeniscusEventCallback};
use crate::status::{Failure, MeniscusStatus, Outcome, c_text, call, catch_panic};
use crate::text::{array, optional, optional_path, path};

/// Options of a call. Their keys are the names of the program's options: "spacing", "cell-size",
/// "threads". They must be freed by meniscus_options_free.
///
/// `meniscus reconstruct --help` documents the options, and meniscus_options_key lists their keys.
/// An option that is not set has the program's default, with two exceptions. All stages run on the
/// CPU unless "backend" or "device" is set. Functions other than meniscus_convert write scratch
/// files to the system's temporary folder unless "scratch" is set. A call with NULL instead of
/// options uses all defaults.
///
/// A call copies the options when it starts, so you may change or free them when the call returns.
/// Several threads may use the same options at the same time, as long as no thread changes or frees
/// them.
#[derive(Clone, Default)]
pub struct MeniscusOptions {
    settings: Settings,
    machine: Machine,
    frames: Frames,
    progress: Option<Listener>,
    event: Option<EventListener>,
    cancel: Option<Cancel>,
}

/// Defines the options that are not settings of the library. Each option has a help text, a key, a
/// type, and a function that reads its value.
macro_rules! options {
    ($(#[$about:meta])* $options:ident: $($(#[doc = $help:literal])* $key:ident: $type:ty = $read:expr,)*) => {
        $(#[$about])*
        #[derive(Clone, Default)]
        struct $options {
            $($key: Option<$type>,)*
        }

        impl $options {
            /// The keys of all options, with their help texts.
            const KEYS: &[(&str, &str)] = &[$((stringify!($key), concat!($($help),*))),*];

            /// Sets the option called `key`, or resets it if `value` is `None`. Returns `false` if
            /// no option has this key.
            fn set<S: Source<Error = String>>(&mut self, key: &str, value: Option<&S>) -> Result<bool, String> {
                match key {
                    $(stringify!($key) => self.$key = value.map($read).transpose()?,)*
                    _ => return Ok(false),
                }
                Ok(true)
            }

            /// The key of the first option that is set.
            #[allow(dead_code, reason = "only `RequestParts::new` calls this, on `Frames`")]
            fn first(&self) -> Option<&'static str> {
                [$(self.$key.is_some().then_some(stringify!($key))),*].into_iter().flatten().next()
            }
        }
    };
}

options! {
    /// Options of the machine: backend and resources.
    Machine:
    /// Backend: auto, cpu or vulkan; all backends make the same mesh [default: cpu, or vulkan if a
    /// device is set].
    backend: Backend = Backend::read,
    /// Vulkan device, by its number, its UUID or a part of its name [default: the best].
    device: String = |device| device.text().or_else(|_| device.count::<u32>().map(|number| number.to_string())),
    /// Threads to use, at most 1024 [default: all cores].
    threads: usize = Source::count,
    /// Memory to use besides particles and mesh, in bytes or as 512MiB [default: three quarters of
    /// the available memory].
    memory: u64 = bytes,
    /// Folder for scratch files [default: the system's temporary folder, or a conversion's output].
    scratch: PathBuf = |folder| folder.text().map(PathBuf::from),
}

options! {
    /// The frames of a conversion.
    Frames:
    /// For meniscus_convert: the first frame of the simulation.
    start: i64 = frame,
    /// For meniscus_convert: the last frame of the simulation.
    end: i64 = frame,
    /// For meniscus_convert: the step between the numbers of frames to convert.
    step: u64 = step,
    /// For meniscus_convert: convert only these frames of the simulation, such as 100..199, as one
    /// of several jobs.
    frames: (i64, i64) = range,
    /// For meniscus_convert: resume an interrupted conversion, and keep finished frames. If
    /// settings have changed, the conversion fails, unless `overwrite` is set.
    resume: bool = Source::switch,
    /// For meniscus_convert: replace existing outputs.
    overwrite: bool = Source::switch,
    /// For meniscus_convert: follow a running simulation until its last frame, or until no file
    /// has appeared or changed for this many seconds.
    watch: f64 = Source::number,
    /// For meniscus_convert: frames per second, if the files have no times.
    fps: f64 = Source::number,
    /// For meniscus_convert: join the frames with the same number from all inputs, such as several
    /// fluids.
    together: bool = Source::switch,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Backend {
    Auto,
    Cpu,
    Vulkan,
}

impl Backend {
    fn read<S: Source>(value: &S) -> Result<Self, S::Error> {
        Ok([Self::Auto, Self::Cpu, Self::Vulkan][value.one_of(&["auto", "cpu", "vulkan"])?])
    }
}

fn bytes<S: Source<Error = String>>(size: &S) -> Result<u64, String> {
    let bytes = match size.text() {
        Ok(text) => text.parse().ok().map(|size: ByteSize| size.as_u64()),
        Err(_) => size.count().ok(),
    };
    bytes.ok_or_else(|| "expected a number of bytes, or a size such as 512MiB".into())
}

fn step<S: Source<Error = String>>(value: &S) -> Result<u64, String> {
    Some(value.count()?)
        .filter(|&step| step > 0)
        .ok_or_else(|| "expected a whole number, 1 or greater".into())
}

/// The number of a frame, which may be negative.
fn frame<S: Source<Error = String>>(value: &S) -> Result<i64, String> {
    // f64 represents all integers up to this one, 2^53, exactly.
    const LARGEST: f64 = 9_007_199_254_740_992.0;
    let is_whole = |number: &f64| number.fract() == 0.0 && number.abs() <= LARGEST;
    let number = match value.text() {
        Ok(text) => text.parse().ok(),
        Err(_) => value.number().ok().filter(is_whole).map(|number| number as i64),
    };
    number.ok_or_else(|| "expected a whole number".into())
}

fn range<S: Source<Error = String>>(value: &S) -> Result<(i64, i64), String> {
    let text = value.text()?;
    let ends = text.split_once("..");
    let ends = ends.and_then(|(first, last)| Some((first.parse().ok()?, last.parse().ok()?)));
    ends.filter(|(first, last)| first <= last)
        .ok_or_else(|| "expected the first and the last frame number, such as 100..199".into())
}

impl Frames {
    fn of(&self, simulation: Simulation) -> Simulation {
        let mut simulation = simulation;
        if let Some(start) = self.start {
            simulation = simulation.start(start);
        }
        if let Some(end) = self.end {
            simulation = simulation.end(end);
        }
        if let Some(step) = self.step {
            simulation = simulation.step(step);
        }
        if let Some((first, last)) = self.frames {
            simulation = simulation.frames(first..=last);
        }
        if let Some(seconds) = self.watch {
            simulation = simulation.watch(seconds);
        }
        if let Some(fps) = self.fps {
            simulation = simulation.fps(fps);
        }
        if self.together == Some(true) {
            simulation = simulation.together();
        }
        if self.resume == Some(true) {
            simulation = simulation.resume();
        }
        if self.overwrite == Some(true) { simulation.overwrite() } else { simulation }
    }
}

impl MeniscusOptions {
    /// Sets the option called `key`, or resets it if `value` is `None`. Returns `false` if no
    /// option has this key.
    fn set<S: Source<Error = String>>(
        &mut self,
        key: &str,
        value: Option<&S>,
    ) -> Result<bool, String> {
        let Some(setting) = Setting::by_key(key) else {
            return Ok(self.machine.set(key, value)? || self.frames.set(key, value)?);
        };
        match value {
            Some(value) => self.settings.set(setting.name(), value),
            None => Ok(self.settings.clear(setting.name())),
        }
    }

    /// Sets the option called `key`, or returns an error that describes the invalid key or value.
    fn set_or_error<S: Source<Error = String> + Debug>(
        &mut self,
        key: &str,
        value: Option<&S>,
    ) -> Outcome {
        match self.set(key, value) {
            Ok(true) => Ok(()),
            Ok(false) => Err(Failure::request(format!(
                "no option has the key {key:?}; meniscus_options_key lists all keys"
            ))),
            Err(expected) => {
                let shown = value.map_or_else(String::new, |value| format!("{value:?}"));
                let shown: String = shown.chars().take(LONGEST_VALUE).collect();
                Err(Failure::request(format!("{key}: {expected}, got {shown}")))
            }
        }
    }
}

/// Messages show at most this many characters of an invalid value.
const LONGEST_VALUE: usize = 100;

/// The options of a call, as a request whose backend has not been chosen yet.
pub struct RequestParts {
    pub request: Reconstruction,
    pub control: Control,
    pub event: Option<EventListener>,
    memory: MemoryBudget,
    backend: Option<Backend>,
    device: Option<String>,
    frames: Frames,
}

impl RequestParts {
    /// Reads the options of a call that makes one frame at a time. Options that apply only to
    /// conversions cause an error.
    ///
    /// # Safety
    /// `options` must be NULL or a handle that has not been freed.
    pub unsafe fn new(options: *const MeniscusOptions) -> Outcome<Self> {
        // SAFETY: the caller upholds this function's contract.
        let parts = unsafe { Self::for_frames(options) };
        match parts.frames.first() {
            Some(key) => Err(Failure::request(format!("{key} works only with meniscus_convert"))),
            None => Ok(parts),
        }
    }

    /// Reads the options of a conversion.
    ///
    /// # Safety
    /// The requirements of [`RequestParts::new`].
    pub unsafe fn for_frames(options: *const MeniscusOptions) -> Self {
        // SAFETY: the caller upholds this function's contract.
        let options = unsafe { options.as_ref() }.cloned().unwrap_or_default();
        let MeniscusOptions { settings, machine, frames, progress, event, cancel } = options;
        let control = Control::new(progress, cancel);
        let memory = machine.memory.map_or_else(default_memory, MemoryBudget);
        let mut request =
            control.attach_to(Reconstruction::new().with_settings(settings)).memory(memory);
        if let Some(threads) = machine.threads {
            request = request.threads(threads);
        }
        if let Some(folder) = machine.scratch {
            request = request.scratch(folder);
        }
        let Machine { backend, device, .. } = machine;
        Self { request, control, event, memory, backend, device, frames }
    }

    /// Creates the conversion that the options describe.
    pub fn simulation(&self, inputs: Vec<PathBuf>, output: PathBuf) -> Simulation {
        self.frames.of(Simulation::of_files(inputs, output)).reconstruction(self.request.clone())
    }

    /// Chooses the backend. `input_bytes` returns the size of the input, if known. This function
    /// calls it only if the choice depends on the size.
    pub fn on_machine(
        mut self,
        input_bytes: impl FnOnce(&Reconstruction) -> Option<u64>,
    ) -> Outcome<Self> {
        use Backend::{Auto, Cpu, Vulkan};
        let open = |choice| device(&choice, None).map_err(Error::from);
        let backend = match (self.backend, self.device.take()) {
            (None | Some(Cpu), None) => return Ok(self),
            (Some(Cpu), Some(_)) => {
                return Err(Failure::request("device cannot be used with backend cpu"));
            }
            (Some(Auto), None) if !self.request.uses_backend() => return Ok(self),
            _ if !self.request.uses_backend() => {
                return Err(Failure::request("backend: kernel methods run only on the CPU"));
            }
            (Some(Auto), None) => fastest(self.memory, || input_bytes(&self.request), None).0,
            (Some(Vulkan), None) => open(DeviceChoice::Best)?,
            (None | Some(Auto | Vulkan), Some(named)) => open(DeviceChoice::Named(named))?,
        };
        self.request = self.request.backend(backend);
        Ok(self)
    }

    /// Chooses the backend for an input file according to its size.
    pub fn for_file(self, file: &Path) -> Outcome<Self> {
        self.on_machine(|_| bytes_of([file]))
    }
}

/// Converts the argument `overwrite` of a C function.
pub fn replacing(overwrite: i32) -> Replace {
    if overwrite == 0 { Replace::Refuse } else { Replace::Allow }
}

/// Returns the options of a handle, or an error if the handle is NULL.
///
/// # Safety
/// `options` must be NULL or a handle that has not been freed. No other thread may use it during
/// the call.
unsafe fn options_of<'a>(options: *mut MeniscusOptions) -> Outcome<&'a mut MeniscusOptions> {
    // SAFETY: the caller upholds this function's contract.
    unsafe { options.as_mut() }.ok_or_else(|| Failure::request("options is NULL"))
}

/// Reads the caller's key, which must not be NULL.
///
/// # Safety
/// The requirements of [`optional`].
unsafe fn key<'a>(key: *const c_char) -> Outcome<&'a str> {
    // SAFETY: the caller upholds this function's contract.
    unsafe { optional(key, "key") }?.ok_or_else(|| Failure::request("key is NULL"))
}

/// Creates options with default values. They must be freed by meniscus_options_free.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_options_new() -> *mut MeniscusOptions {
    catch_panic(std::ptr::null_mut(), || Box::into_raw(Box::default()))
}

/// Copies options, including their callbacks and their cancel handle. The copy must be freed by
/// meniscus_options_free. If `options` is NULL, the copy has default values.
///
/// `options` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_options_copy(
    options: *const MeniscusOptions,
) -> *mut MeniscusOptions {
    // SAFETY: the caller upholds this function's contract.
    let options = unsafe { options.as_ref() };
    catch_panic(std::ptr::null_mut(), || {
        Box::into_raw(Box::new(options.cloned().unwrap_or_default()))
    })
}

/// Frees options; NULL is ignored.
///
/// `options` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_options_free(options: *mut MeniscusOptions) {
    // SAFETY: the caller upholds this function's contract.
    unsafe { free(options) };
}

/// Sets an option from text, as on the command line: `meniscus_options_set(options, "domain",
/// "0,0,-,1,2,-")`.
///
/// The decimal separator is '.' in every locale. Commas or spaces separate the numbers of a list,
/// and commas separate names. A switch such as "normals" takes "true" or "false". If `value` is
/// NULL, the option is reset to its default.
///
/// Returns MENISCUS_STATUS_REQUEST for an unknown key and for a value of the wrong type: the
/// message names the key, the value and the expected type, and the option keeps its old value. This
/// function does not check whether a number is out of range or whether options conflict; the call
/// that uses the options checks this.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_options_set(
    options: *mut MeniscusOptions,
    key: *const c_char,
    value: *const c_char,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (options, key) = unsafe { (options_of(options)?, self::key(key)?) };
        if key == "scratch" {
            // Read the scratch folder as a path, because a path need not be UTF-8.
            // SAFETY: the caller upholds this function's contract.
            options.machine.scratch = unsafe { optional_path(value, key) }?;
            return Ok(());
        }
        // SAFETY: the caller upholds this function's contract.
        let text = unsafe { optional(value, key) }?;
        options.set_or_error(key, text.as_ref())
    })
}

/// Sets an option from a number. A switch takes 0 or 1. In all other respects, the function works
/// like meniscus_options_set.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_options_set_number(
    options: *mut MeniscusOptions,
    key: *const c_char,
    value: f64,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (options, key) = unsafe { (options_of(options)?, self::key(key)?) };
        options.set_or_error(key, Some(&[value].as_slice()))
    })
}

/// Sets an option from several numbers: 3 for a point, or 6 for a box, with its lowest corner
/// first. -INFINITY and INFINITY leave a side of a box open. In all other respects, the function
/// works like meniscus_options_set.
///
/// Pointers must be NULL or valid as described; `values` must point to `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_options_set_numbers(
    options: *mut MeniscusOptions,
    key: *const c_char,
    values: *const f64,
    count: usize,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (options, key) = unsafe { (options_of(options)?, self::key(key)?) };
        // SAFETY: the caller upholds this function's contract.
        let numbers = unsafe { array(values, count, key) }?;
        options.set_or_error(key, Some(&numbers))
    })
}

/// Sets the function that receives the progress of a frame, and its argument `user`. If `progress`
/// is NULL, the library reports no progress. meniscus_convert does not call the function.
///
/// A simulation that was created with these options can call this function until the simulation is
/// freed. All other functions of the library call it only before they return.
///
/// `options` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_options_on_progress(
    options: *mut MeniscusOptions,
    progress: MeniscusProgressCallback,
    user: *mut c_void,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        unsafe { options_of(options) }?.progress =
            progress.map(|callback| Listener { callback, user });
        Ok(())
    })
}

/// Sets the function that receives the events of meniscus_convert, and its argument `user`. If
/// `event` is NULL, the library reports no events.
///
/// `options` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_options_on_event(
    options: *mut MeniscusOptions,
    event: MeniscusEventCallback,
    user: *mut c_void,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        unsafe { options_of(options) }?.event =
            event.map(|callback| EventListener { callback, user });
        Ok(())
    })
}

/// Sets the handle with which any thread can cancel the work. If `cancel` is NULL, removes the
/// current handle. The handle may be freed before the options.
///
/// If a callback cancels the work, the library also cancels the handle.
///
/// Pointers must be NULL or handles that have not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_options_cancel_by(
    options: *mut MeniscusOptions,
    cancel: *const MeniscusCancel,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (options, cancel) = unsafe { (options_of(options)?, cancel.as_ref()) };
        options.cancel = cancel.map(|handle| handle.cancel.clone());
        Ok(())
    })
}

/// All keys with their help texts, as C strings.
static KEYS: LazyLock<Vec<(CString, CString)>> = LazyLock::new(|| {
    let settings = Settings::ALL.iter().map(|setting| (setting.key(), setting.help()));
    let others = [Machine::KEYS, Frames::KEYS].into_iter().flatten();
    let others = others.map(|&(key, help)| (key.to_owned(), help.trim().to_owned()));
    settings.chain(others).map(|(key, help)| (c_text(key), c_text(help))).collect()
});

/// Returns the key of the option with this index, or NULL if there is no such option. The string is
/// static.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_options_key(index: usize) -> *const c_char {
    catch_panic(null(), || KEYS.get(index).map_or(null(), |(key, _)| key.as_ptr()))
}

/// Returns one line of help on the option with this index, or NULL if there is no such option. The
/// string is static.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_options_help(index: usize) -> *const c_char {
    catch_panic(null(), || KEYS.get(index).map_or(null(), |(_, help)| help.as_ptr()))
}

/// Checks in advance that a mesh can be written to `path`, whose extension selects the format, and
/// that the format can store the requested data. The function creates no file.
///
/// If `options` is NULL, all options have their defaults. `overwrite`: nonzero if an existing file
/// may be replaced.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_check_output(
    path: *const c_char,
    options: *const MeniscusOptions,
    overwrite: i32,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (path, parts) = unsafe { (self::path(path, "path")?, RequestParts::new(options)?) };
        parts.request.output(&path, replacing(overwrite))?;
        Ok(())
    })
}
