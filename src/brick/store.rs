//! Where the samples of a field are: in memory, or somewhere else with the pages last used in memory.

use std::fmt::Debug;
use std::ops::Deref;
use std::sync::Arc;

use quick_cache::sync::Cache;
use quick_cache::{OptionsBuilder, Weighter};

/// Bytes of a cached page besides its samples: its entry in the cache, and the heads of its allocations.
const CACHED_PAGE: u64 = 96;

/// Samples that are not in memory, page by page.
pub trait PageSource: Send + Sync + Debug {
    /// The samples of page number `page`, as they were stored, anew each time.
    fn samples(&self, page: usize) -> Arc<[u16]>;
}

/// The samples of a page: those in the field's own memory, or a copy.
#[derive(Debug)]
pub enum Samples<'a> {
    #[allow(missing_docs)]
    Borrowed(&'a [u16]),
    #[allow(missing_docs)]
    Shared(Arc<[u16]>),
}

impl Deref for Samples<'_> {
    type Target = [u16];

    #[inline]
    fn deref(&self) -> &[u16] {
        match self {
            Self::Borrowed(samples) => samples,
            Self::Shared(samples) => samples,
        }
    }
}

impl AsRef<[u16]> for Samples<'_> {
    fn as_ref(&self) -> &[u16] {
        self
    }
}

/// The samples of all pages of a field.
#[derive(Debug)]
pub(super) enum Store {
    Memory(Vec<Box<[u16]>>),
    Paged { source: Box<dyn PageSource>, cache: Cache<u32, Arc<[u16]>, Bytes> },
}

impl Store {
    /// Pages of `mean_bytes` on average, as many of them in memory as fit into `cache_bytes`.
    pub(super) fn paged(source: Box<dyn PageSource>, cache_bytes: u64, mean_bytes: u64) -> Self {
        let items = cache_bytes / (mean_bytes + CACHED_PAGE);
        let options = OptionsBuilder::new()
            .estimated_items_capacity(items as usize)
            .weight_capacity(cache_bytes)
            .build()
            .expect("all that has no default is given");
        let cache = Cache::with_options(options, Bytes, Default::default(), Default::default());
        Self::Paged { source, cache }
    }

    /// For a page that is likely to be wanted again soon.
    #[inline]
    pub(super) fn cached(&self, page: u32) -> Samples<'_> {
        match self {
            Self::Memory(pages) => Samples::Borrowed(&pages[page as usize]),
            Self::Paged { source, cache } => {
                let read = || Ok::<_, std::convert::Infallible>(source.samples(page as usize));
                let Ok(samples) = cache.get_or_insert_with(&page, read);
                Samples::Shared(samples)
            }
        }
    }

    /// For a page of a single pass, which must not drive others out.
    pub(super) fn once(&self, page: usize) -> Samples<'_> {
        match self {
            Self::Memory(pages) => Samples::Borrowed(&pages[page]),
            Self::Paged { source, .. } => Samples::Shared(source.samples(page)),
        }
    }
}

/// Weighs pages by what they take of memory.
#[derive(Debug, Clone)]
pub(super) struct Bytes;

impl Weighter<u32, Arc<[u16]>> for Bytes {
    fn weight(&self, _: &u32, samples: &Arc<[u16]>) -> u64 {
        CACHED_PAGE + size_of_val(&**samples) as u64
    }
}
