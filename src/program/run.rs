//! Options for messages and for resources: threads, memory, scratch folder and backend.

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::{Args, ValueEnum};
use meniscus::devices::{self, Backend, CpuReason, DeviceChoice};
use meniscus::{Error, MemoryBudget, Reconstruction, default_memory};

use super::notes::Notes;

/// Maximum number of threads: more than the number of cores of most machines, but few enough for
/// the system to start them all.
const MOST_THREADS: usize = 1024;

#[derive(Args)]
pub struct RunOptions {
    /// Where to compute: on the CPU or on a GPU.
    #[arg(long, value_enum, default_value_t = BackendName::Auto, help_heading = "Machine")]
    backend: BackendName,
    /// Number, UUID or part of the name of a Vulkan device; `meniscus devices` lists the devices
    /// [default: the best device].
    #[arg(long, value_name = "DEVICE", help_heading = "Machine", hide_short_help = true)]
    device: Option<String>,
    /// Number of threads [default: one per core].
    #[arg(long, value_name = "N", help_heading = "Machine", hide_short_help = true)]
    threads: Option<usize>,
    /// Memory limit, such as 512MiB or 8GiB.
    ///
    /// The default is three quarters of the available memory.
    #[arg(long, value_name = "SIZE", help_heading = "Machine")]
    memory: Option<ByteSize>,
    /// Folder for the scratch files of frames that exceed the memory limit [default: the output's
    /// folder].
    #[arg(long, value_name = "DIR", help_heading = "Machine", hide_short_help = true)]
    scratch: Option<PathBuf>,
    /// Replace existing outputs.
    #[arg(long, help_heading = "Output")]
    pub overwrite: bool,
    /// Print only errors.
    #[arg(short, long, conflicts_with = "verbose", help_heading = "Messages")]
    quiet: bool,
    /// Print details.
    #[arg(short, long, help_heading = "Messages")]
    verbose: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum BackendName {
    /// A discrete GPU if there is one and the input is large enough, else the CPU.
    Auto,
    /// The CPU.
    Cpu,
    /// A Vulkan device.
    Vulkan,
}

impl RunOptions {
    /// Sets threads, memory, scratch folder and backend of a request. `input_bytes` returns the
    /// size of the inputs in bytes, if known. This function calls it only if the choice of the
    /// backend depends on this size.
    pub fn machine(
        &self,
        request: Reconstruction,
        output: &Path,
        input_bytes: impl FnOnce() -> Option<u64>,
    ) -> Result<Reconstruction, Error> {
        let mut request = request;
        if let Some(threads) = self.threads {
            if !(1..=MOST_THREADS).contains(&threads) {
                return Err(Error::Request(format!(
                    "--threads must be from 1 to {MOST_THREADS}, got {threads}"
                )));
            }
            request = request.threads(threads);
        }
        let budget = self.memory.map_or_else(default_memory, |size| MemoryBudget(size.as_u64()));
        // The output's folder may not exist yet, so scratch files use the nearest existing
        // parent folder.
        let output_folder =
            output.ancestors().skip(1).find(|folder| folder.is_dir()).unwrap_or(Path::new("."));
        let scratch =
            self.scratch.as_deref().or(Some(output_folder).filter(|_| !is_device(output)));
        request = request.memory(budget);
        if let Some(folder) = scratch {
            request = request.scratch(folder);
        }
        Ok(match self.backend(budget, input_bytes)? {
            Some(backend) => request.backend(backend),
            None => request,
        })
    }

    /// Whether `--backend vulkan` was given.
    pub fn is_backend_vulkan(&self) -> bool {
        matches!(self.backend, BackendName::Vulkan)
    }

    fn backend(
        &self,
        budget: MemoryBudget,
        input_bytes: impl FnOnce() -> Option<u64>,
    ) -> Result<Option<Backend>, Error> {
        let cache = dirs::cache_dir().map(|folder| folder.join("meniscus"));
        match (self.backend, &self.device) {
            (BackendName::Cpu, Some(_)) => {
                Err(Error::Request("--device needs --backend vulkan, not --backend cpu".into()))
            }
            (BackendName::Cpu, None) => Ok(None),
            (BackendName::Auto, None) => {
                let (backend, on_cpu) = devices::fastest(budget, input_bytes, cache.as_deref());
                if let Some(why) = on_cpu {
                    let advice = match why {
                        CpuReason::LittleMemory(_) => "; use a larger --memory",
                        CpuReason::NotConformant(_) => "; --backend vulkan uses it anyway",
                        _ => "",
                    };
                    self.notes().detail(format!("using the CPU: {why}{advice}"));
                }
                Ok(Some(backend))
            }
            (BackendName::Auto, Some(_)) | (BackendName::Vulkan, _) => {
                let choice = self.device.clone().map_or(DeviceChoice::Best, DeviceChoice::Named);
                Ok(Some(devices::device(&choice, cache.as_deref())?))
            }
        }
    }

    pub fn notes(&self) -> Notes {
        Notes::new(self.quiet, self.verbose)
    }
}

/// Total size, in bytes, of the files; `None` if a file is missing, or if the size of a file does
/// not indicate how many particles it contains.
pub fn bytes_of<'a>(files: impl IntoIterator<Item = &'a Path>) -> Option<u64> {
    devices::bytes_of(files)
}

/// Whether an output is a device file, next to which no other files can be created.
fn is_device(output: &Path) -> bool {
    output.starts_with("/dev")
}
