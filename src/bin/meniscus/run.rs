//! Options on what a run takes and says: threads, memory, scratch, and notes on standard error.

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::{Args, ValueEnum};
use meniscus::error::Error;
use meniscus::estimate::SMALLEST_BUDGET;
use meniscus::frame::Resources;
use meniscus::io::bytes::Unpacking;
use meniscus::memory::default_budget;
use meniscus::units::MemoryBudget;

/// More than any machine has cores, and few enough to start.
const MOST_THREADS: usize = 1024;

#[derive(Args)]
pub struct RunOptions {
    /// Where the stages run.
    #[arg(long, value_enum, default_value_t = BackendName::Auto)]
    backend: BackendName,
    /// Threads to use [default: all cores].
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Memory to use, as 512MiB or 8GiB [default: three quarters of what is available].
    #[arg(long, value_name = "SIZE")]
    memory: Option<ByteSize>,
    /// Folder for scratch files, where a frame exceeds its memory [default: the output's folder].
    #[arg(long, value_name = "DIR")]
    scratch: Option<PathBuf>,
    /// Replace an output that exists.
    #[arg(long)]
    pub overwrite: bool,
    /// Say nothing but errors.
    #[arg(short, long, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more.
    #[arg(short, long)]
    verbose: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum BackendName {
    /// The best there is.
    Auto,
    /// All cores of this machine.
    Cpu,
}

impl RunOptions {
    /// Starts the threads, and says what a frame may take.
    pub fn resources(&self, output: &Path) -> Result<Resources, Error> {
        if let Some(threads) = self.threads {
            if !(1..=MOST_THREADS).contains(&threads) {
                return Err(Error::Request(format!("--threads must be 1 to {MOST_THREADS}")));
            }
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            pool.build_global().map_err(|e| Error::Request(format!("--threads {threads}: {e}")))?;
        }
        let budget = self.memory.map_or_else(default_budget, |size| MemoryBudget(size.as_u64()));
        if budget < SMALLEST_BUDGET {
            let smallest = ByteSize(SMALLEST_BUDGET.0);
            return Err(Error::Request(format!("--memory must be at least {smallest}")));
        }
        let beside = output.parent().filter(|folder| !folder.as_os_str().is_empty());
        let scratch = self.scratch.as_deref().or(beside).unwrap_or(Path::new("."));
        Ok(Resources { budget, scratch: scratch.to_owned() })
    }

    pub fn notes(&self) -> Notes {
        Notes { quiet: self.quiet, verbose: self.verbose }
    }
}

/// An input that has to be unpacked may take an eighth of the budget.
pub fn unpacking(resources: &Resources) -> Unpacking<'_> {
    Unpacking { in_memory: resources.budget.0 / 8, scratch: &resources.scratch }
}

/// The notes that a run makes for people, on standard error.
pub struct Notes {
    quiet: bool,
    verbose: bool,
}

impl Notes {
    pub fn say(&self, text: impl AsRef<str>) {
        if !self.quiet {
            eprintln!("{}", text.as_ref());
        }
    }

    pub fn detail(&self, text: impl AsRef<str>) {
        if self.verbose {
            eprintln!("{}", text.as_ref());
        }
    }
}
