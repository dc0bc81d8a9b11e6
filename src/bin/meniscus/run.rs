//! Options on what a run takes and says: threads, memory, scratch, and notes on standard error.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytesize::ByteSize;
use clap::{Args, ValueEnum};
use indicatif::MultiProgress;
use meniscus::backend::{Backend, Cpu, Vulkan};
use meniscus::error::Error;
use meniscus::frame::Resources;
use meniscus::frame::estimate::SMALLEST_BUDGET;
use meniscus::grid::units::MemoryBudget;
use meniscus::io::bytes::Unpacking;
use meniscus::system::memory::default_budget;
use meniscus::vulkan::{Device, DeviceChoice, DeviceInfo, DeviceKind, DeviceOptions, Instance, VulkanError};

/// Bytes of particles that two threads make meshes of in about the time, a third of a second, that a driver takes to open a device and to
/// compile kernels, or find them in its cache: a million particles.
const SMALL: u64 = 12_000_000;

/// Budgets below this are not spent on looking for devices: drivers take some 100 MiB.
const DRIVERS: MemoryBudget = MemoryBudget(1 << 30);
/// More than any machine has cores, and few enough to start.
const MOST_THREADS: usize = 1024;

use crate::say::say;

#[derive(Args)]
pub struct RunOptions {
    /// Where the stages run.
    #[arg(long, value_enum, default_value_t = BackendName::Auto, help_heading = "Machine")]
    backend: BackendName,
    /// The Vulkan device, by its number, its UUID or a part of its name: see `meniscus devices` [default: the best].
    #[arg(long, value_name = "DEVICE", help_heading = "Machine", hide_short_help = true)]
    device: Option<String>,
    /// Threads to use [default: all cores].
    #[arg(long, value_name = "N", help_heading = "Machine", hide_short_help = true)]
    threads: Option<usize>,
    /// Memory to use, as 512MiB or 8GiB.
    ///
    /// By default three quarters of what is available.
    #[arg(long, value_name = "SIZE", help_heading = "Machine")]
    memory: Option<ByteSize>,
    /// Folder for scratch files, where a frame exceeds its memory [default: the output's folder].
    #[arg(long, value_name = "DIR", help_heading = "Machine", hide_short_help = true)]
    scratch: Option<PathBuf>,
    /// Replace an output that exists.
    #[arg(long, help_heading = "Output")]
    pub overwrite: bool,
    /// Say nothing but errors.
    #[arg(short, long, conflicts_with = "verbose", help_heading = "Messages")]
    quiet: bool,
    /// Say more.
    #[arg(short, long, help_heading = "Messages")]
    verbose: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum BackendName {
    /// A discrete GPU where there is one, else the CPU.
    Auto,
    /// All cores of this machine.
    Cpu,
    /// A Vulkan device.
    Vulkan,
}

impl RunOptions {
    /// Starts the threads, and says what a frame may take, for inputs of as many bytes as is told where it matters, if that is known.
    pub fn resources(
        &self,
        output: &Path,
        input_bytes: impl FnOnce() -> Option<u64>,
    ) -> Result<Resources, Error> {
        if self.threads.is_some_and(|threads| !(1..=MOST_THREADS).contains(&threads)) {
            return Err(Error::Request(format!("--threads must be 1 to {MOST_THREADS}")));
        }
        // This thread is one of them: work that it finds need not wait for another to wake up.
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(self.threads.unwrap_or(0)).use_current_thread();
        pool.build_global().map_err(|e| Error::Request(format!("threads cannot be started: {e}")))?;
        let budget = self.memory.map_or_else(default_budget, |size| MemoryBudget(size.as_u64()));
        if budget < SMALLEST_BUDGET {
            let smallest = ByteSize(SMALLEST_BUDGET.0);
            return Err(Error::Request(format!("--memory must be at least {smallest}")));
        }
        let beside = output.parent().filter(|folder| !folder.as_os_str().is_empty());
        let scratch = self.scratch.as_deref().or(beside).unwrap_or(Path::new("."));
        Ok(Resources { budget, scratch: scratch.to_owned(), backend: self.backend(budget, input_bytes)? })
    }

    /// Whether a device was asked for.
    pub fn vulkan_given(&self) -> bool {
        matches!(self.backend, BackendName::Vulkan)
    }

    fn backend(
        &self,
        budget: MemoryBudget,
        input_bytes: impl FnOnce() -> Option<u64>,
    ) -> Result<Arc<dyn Backend>, Error> {
        match (self.backend, &self.device) {
            (BackendName::Cpu, Some(_)) => Err(Error::Request("--device needs --backend vulkan".into())),
            (BackendName::Cpu, None) => Ok(Arc::new(Cpu)),
            (BackendName::Auto, None) => Ok(self.fast_device(budget, input_bytes).map_or_else(
                |why| {
                    self.notes().detail(format!("on the CPU: {why}"));
                    Arc::new(Cpu) as Arc<dyn Backend>
                },
                |vulkan| Arc::new(vulkan),
            )),
            (BackendName::Auto, Some(_)) | (BackendName::Vulkan, _) => {
                let instance = Instance::connect(false)?;
                let choice = self.device.clone().map_or(DeviceChoice::Best, DeviceChoice::Named);
                Ok(Arc::new(opened(&instance, &instance.choose(&choice)?)?))
            }
        }
    }

    /// A device that is worth while without being asked for, or why there is none.
    fn fast_device(
        &self,
        budget: MemoryBudget,
        input_bytes: impl FnOnce() -> Option<u64>,
    ) -> Result<Vulkan, String> {
        if budget < DRIVERS {
            return Err(format!("drivers of GPUs may need {}, and --memory is less", ByteSize(DRIVERS.0)));
        }
        if !may_have_gpu() {
            return Err("there is no GPU".into());
        }
        if let Some(bytes) = input_bytes().filter(|&bytes| bytes < SMALL) {
            return Err(format!("{} of particles are done before a GPU is ready", ByteSize(bytes)));
        }
        let text = |error: VulkanError| error.to_string();
        let instance = Instance::connect(false).map_err(text)?;
        let info = instance.choose(&DeviceChoice::Best).map_err(text)?;
        if info.kind != DeviceKind::Discrete {
            return Err(format!("{} is no discrete GPU", info.name));
        }
        if !info.is_conformant() {
            return Err(format!("{} passes no conformance tests; --backend vulkan takes it", info.name));
        }
        opened(&instance, &info).map_err(text)
    }

    pub fn notes(&self) -> Notes {
        Notes { quiet: self.quiet, verbose: self.verbose, bars: None }
    }
}

/// A device with its kernels compiled, that may take three quarters of what is free of its memory.
fn opened(instance: &Arc<Instance>, info: &DeviceInfo) -> Result<Vulkan, VulkanError> {
    let pipeline_cache = dirs::cache_dir().map(|folder| folder.join("meniscus"));
    let options =
        DeviceOptions { memory: Some(info.free / 4 * 3), pipeline_cache, ..DeviceOptions::default() };
    let choice = DeviceChoice::Named(info.index.to_string());
    Vulkan::new(Device::open(instance, &choice, &options)?)
}

/// Formats whose files do not tell how much their particles are: compressed, or in several pieces.
const UNTOLD: [&str; 4] = ["gz", "mnf", "npz", "bi4"];

/// Bytes of particles in some files, if all of them are there and tell.
pub fn bytes_of<'a>(files: impl IntoIterator<Item = &'a Path>) -> Option<u64> {
    let bytes = |file: &Path| {
        let extension = file.extension().unwrap_or_default().to_ascii_lowercase();
        let told = UNTOLD.iter().all(|untold| extension != *untold);
        std::fs::metadata(file).ok().filter(|_| told).map(|metadata| metadata.len())
    };
    files.into_iter().map(bytes).sum()
}

/// Whether it is worth while to load Vulkan's drivers, of which some compute on the processor.
fn may_have_gpu() -> bool {
    let nodes = ["/dev/dri", "/dev/nvidia0", "/dev/dxg"];
    !cfg!(target_os = "linux") || nodes.iter().any(|node| Path::new(node).exists())
}

/// An input that has to be unpacked or decoded may take an eighth of the budget.
pub fn unpacking(resources: &Resources) -> Unpacking<'_> {
    Unpacking { in_memory: resources.budget.0 / 8, scratch: &resources.scratch }
}

/// The notes that a run makes for people, on standard error.
#[derive(Clone, Default)]
pub struct Notes {
    quiet: bool,
    verbose: bool,
    /// Bars that stand below the notes.
    bars: Option<MultiProgress>,
}

impl Notes {
    /// The same notes above bars.
    pub fn above(self, bars: MultiProgress) -> Self {
        Self { bars: Some(bars), ..self }
    }

    /// No notes at all.
    pub fn none() -> Self {
        Self { quiet: true, ..Self::default() }
    }

    pub fn is_quiet(&self) -> bool {
        self.quiet
    }

    pub fn say(&self, text: impl AsRef<str>) {
        if !self.quiet {
            self.print(text.as_ref());
        }
    }

    pub fn detail(&self, text: impl AsRef<str>) {
        if self.verbose {
            self.print(text.as_ref());
        }
    }

    /// Says what even a quiet run has to say.
    pub fn error(&self, text: impl AsRef<str>) {
        self.print(text.as_ref());
    }

    fn print(&self, text: &str) {
        match &self.bars {
            Some(bars) => bars.suspend(|| say(text)),
            None => say(text),
        }
    }
}
