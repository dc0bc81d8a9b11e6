//! Available and peak memory of this process.

use std::alloc::{Layout, handle_alloc_error};
use std::fs::read_to_string;
use std::io;

use bytemuck::Zeroable;
use bytemuck::allocation::try_zeroed_vec;
use memmap2::MmapMut;

use crate::grid::units::MemoryBudget;

/// Returns three quarters of the available memory: the system's estimate, or less if a control
/// group or `ulimit` allows less.
///
/// If none of these is known, the result is unlimited.
#[must_use]
pub fn default_memory() -> MemoryBudget {
    let available =
        [system_available(), group_available(), limit_available()].into_iter().flatten().min();
    MemoryBudget(available.map_or(u64::MAX, |bytes| bytes / 4 * 3))
}

#[cfg(target_os = "linux")]
fn system_available() -> Option<u64> {
    kib_field(&read_to_string("/proc/meminfo").ok()?, "MemAvailable:")
}

#[cfg(not(target_os = "linux"))]
fn system_available() -> Option<u64> {
    let mut system = sysinfo::System::new();
    system.refresh_memory_specifics(sysinfo::MemoryRefreshKind::nothing().with_ram());
    Some(system.available_memory()).filter(|&bytes| bytes > 0)
}

/// Bytes that this process's control group still allows: its limit minus its use. Reads the files
/// of control groups version 2 or, if they are missing, those of version 1.
fn group_available() -> Option<u64> {
    let number = |path: &str| read_to_string(path).ok()?.trim().parse::<u64>().ok();
    let left = |limit: &str, used: &str| Some(number(limit)?.saturating_sub(number(used)?));
    let group = read_to_string("/proc/self/cgroup").ok()?;
    let own = group.lines().find_map(|line| line.strip_prefix("0::"));
    let own = own.map(|group| format!("/sys/fs/cgroup{}", group.trim_end_matches('/')));
    let v2 = own
        .iter()
        .map(String::as_str)
        .chain(["/sys/fs/cgroup"])
        .find_map(|dir| left(&format!("{dir}/memory.max"), &format!("{dir}/memory.current")));
    v2.or_else(|| {
        let v1 = "/sys/fs/cgroup/memory/memory";
        left(&format!("{v1}.limit_in_bytes"), &format!("{v1}.usage_in_bytes"))
    })
}

/// Bytes of memory that this process's limits on data and on address space still allow. Files that
/// the process maps later also use address space, but the result does not account for them.
fn limit_available() -> Option<u64> {
    let left = |name: &str, used: &str| {
        let used = kib_field(&read_to_string("/proc/self/status").ok()?, used)?;
        Some(limit(name)?.saturating_sub(used))
    };
    let all = [left("Max data size", "VmData:"), left("Max address space", "VmSize:")];
    all.into_iter().flatten().min()
}

/// Default size, in bytes, of a thread's stack. It applies to threads that choose no size, such as
/// those of Vulkan drivers.
#[must_use]
pub fn default_stack() -> Option<u64> {
    limit("Max stack size")
}

/// Returns this process's limit called `name` in `/proc/self/limits`; `None` if it is unlimited or
/// unknown.
fn limit(name: &str) -> Option<u64> {
    let limits = read_to_string("/proc/self/limits").ok()?;
    let line = limits.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse().ok()
}

/// Peak resident memory of this process, in bytes, including mapped files.
#[must_use]
pub fn peak_memory() -> Option<u64> {
    kib_field(&read_to_string("/proc/self/status").ok()?, "VmHWM:")
}

/// Returns a vector of zeros, in huge pages if the system has them. In huge pages, random writes
/// need fewer page lookups and page faults.
pub(crate) fn zeroed_in_huge_pages<T: Zeroable>(len: usize) -> Vec<T> {
    let zeros = zeroed(len);
    advise_huge_pages(&zeros);
    zeros
}

/// Returns a vector of zeros. If there is not enough memory, the process aborts, as for any other
/// vector.
pub(crate) fn zeroed<T: Zeroable>(len: usize) -> Vec<T> {
    try_zeroed_vec(len).unwrap_or_else(|()| {
        handle_alloc_error(Layout::array::<T>(len).expect("an array of at most isize::MAX bytes"))
    })
}

/// Returns an empty vector with this capacity, in huge pages if the system has them.
pub(crate) fn empty_in_huge_pages<T>(capacity: usize) -> Vec<T> {
    let mut empty = Vec::with_capacity(capacity);
    advise_huge_pages(empty.spare_capacity_mut());
    empty
}

/// Maps `bytes` bytes of zeros outside the heap, in huge pages if the system has them and at least
/// one huge page fits into the mapping.
///
/// # Errors
/// If the system has no memory left.
pub(crate) fn mapped_in_huge_pages(bytes: usize) -> io::Result<MmapMut> {
    let zeros = MmapMut::map_anon(bytes)?;
    advise_huge_pages(&zeros);
    Ok(zeros)
}

/// Asks the system for huge pages. Must be called before anything is written to `memory`, because
/// pages keep the size with which they were created.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn advise_huge_pages<T>(memory: &[T]) {
    /// The size, in bytes, of huge pages on most machines. On machines with larger huge pages, a
    /// smaller part of the memory is in huge pages.
    const HUGE: usize = 2 << 20;
    let bytes = memory.as_ptr().cast::<u8>();
    let first = bytes.align_offset(HUGE).min(size_of_val(memory));
    let whole = (size_of_val(memory) - first) / HUGE * HUGE;
    if whole > 0 {
        // SAFETY: all these pages are within `memory`, and the call does not change their contents.
        // If there are no huge pages, the call fails, and nothing changes.
        unsafe { libc::madvise(bytes.add(first).cast_mut().cast(), whole, libc::MADV_HUGEPAGE) };
    }
}

/// Does nothing: other systems choose the size of pages themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn advise_huge_pages<T>(_: &[T]) {}

fn kib_field(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}
