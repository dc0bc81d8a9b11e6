//! Where the samples of a field are: in memory, or somewhere else with the pages last used in
//! memory.

use std::borrow::Cow;
use std::fmt::Debug;
use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use quick_cache::sync::Cache;
use quick_cache::{OptionsBuilder, Weighter};

use super::{PageSamples, PageShape, RemotePages};

/// Bytes of a cached page besides its samples: its entry in the cache, and the heads of its
/// allocations.
const CACHED_PAGE: u64 = 136;

/// Samples that are not in memory, page by page.
pub trait PageSource: Send + Sync + Debug {
    /// The samples of page number `page`, as they were stored, anew each time.
    fn samples(&self, page: usize) -> Vec<u16>;
}

/// Pages that come at once, of those that are elsewhere: neighbours are wanted together.
const TOGETHER: usize = 64;

/// A page that is in memory: in the field's own, or in its cache.
pub(super) enum CachedPage<'a> {
    Own(&'a PageSamples),
    Shared(Arc<PageSamples>),
}

impl Deref for CachedPage<'_> {
    type Target = PageSamples;

    #[inline]
    fn deref(&self) -> &PageSamples {
        match self {
            Self::Own(samples) => samples,
            Self::Shared(samples) => samples,
        }
    }
}

/// The samples of all pages of a field.
#[derive(Debug)]
pub(super) enum PageStore {
    Memory(Vec<PageSamples>),
    Paged {
        source: Box<dyn PageSource>,
        cache: Cache<u32, Arc<PageSamples>, PageWeighter>,
    },
    /// Pages outside of the host's memory; those wanted on the host are kept in it too,
    /// [`TOGETHER`] at a time.
    Elsewhere {
        pages: Box<dyn RemotePages>,
        otherwise: Box<dyn PageSource>,
        here: Vec<OnceLock<Vec<PageSamples>>>,
    },
}

impl PageStore {
    /// Pages of `mean_bytes` on average at the most, as many of them in memory as fit into
    /// `cache_bytes`.
    pub(super) fn paged(source: Box<dyn PageSource>, cache_bytes: u64, mean_bytes: u64) -> Self {
        let items = cache_bytes / (mean_bytes + CACHED_PAGE);
        let options = OptionsBuilder::new()
            .estimated_items_capacity(items as usize)
            .weight_capacity(cache_bytes)
            .build()
            .expect("all that has no default is given");
        let cache =
            Cache::with_options(options, PageWeighter, Default::default(), Default::default());
        Self::Paged { source, cache }
    }

    /// Pages that are elsewhere; where that fails they are made by `otherwise`.
    pub(super) fn elsewhere(pages: Box<dyn RemotePages>, otherwise: Box<dyn PageSource>) -> Self {
        let here =
            std::iter::repeat_with(OnceLock::new).take(pages.count().div_ceil(TOGETHER)).collect();
        Self::Elsewhere { pages, otherwise, here }
    }

    /// Bytes of pages that may be in memory; `None` where all may be.
    pub(super) fn cache_bytes(&self) -> Option<u64> {
        match self {
            Self::Memory(_) | Self::Elsewhere { .. } => None,
            Self::Paged { cache, .. } => Some(cache.capacity()),
        }
    }

    /// For a page that is likely to be wanted again soon.
    #[inline]
    pub(super) fn cached(&self, page: u32, shape: PageShape) -> CachedPage<'_> {
        match self {
            Self::Memory(pages) => CachedPage::Own(&pages[page as usize]),
            Self::Paged { source, cache } => {
                let read = || {
                    let samples = source.samples(page as usize);
                    Ok::<_, std::convert::Infallible>(Arc::new(PageSamples::new(
                        samples.into(),
                        shape,
                    )))
                };
                let Ok(samples) = cache.get_or_insert_with(&page, read);
                CachedPage::Shared(samples)
            }
            Self::Elsewhere { .. } => CachedPage::Own(self.fetched(page as usize, shape)),
        }
    }

    /// For a page of a single pass, which must not drive others out.
    pub(super) fn once(&self, page: usize, shape: PageShape) -> Cow<'_, [u16]> {
        match self {
            Self::Memory(pages) => pages[page].dense(shape),
            Self::Paged { source, .. } => source.samples(page).into(),
            Self::Elsewhere { .. } => self.fetched(page, shape).dense(shape),
        }
    }

    /// A page that is elsewhere, fetched with its neighbours if it was not before.
    ///
    /// # Panics
    /// If all are in memory, or in a cache.
    fn fetched(&self, page: usize, shape: PageShape) -> &PageSamples {
        let Self::Elsewhere { pages, otherwise, here } = self else {
            unreachable!("pages are elsewhere")
        };
        let (group, first) = (&here[page / TOGETHER], page / TOGETHER * TOGETHER);
        let fetched = group.get().unwrap_or_else(|| {
            let range = first..pages.count().min(first + TOGETHER);
            let made = |page| PageSamples::new(otherwise.samples(page).into(), shape);
            let samples = pages.samples(range.clone()).unwrap_or_else(|| range.map(made).collect());
            // Two threads may fetch the same: one that held the other up while it waits for others
            // might wait for itself.
            group.get_or_init(|| samples)
        });
        &fetched[page - first]
    }
}

/// Weighs pages by what they take of memory.
#[derive(Debug, Clone)]
pub(super) struct PageWeighter;

impl Weighter<u32, Arc<PageSamples>> for PageWeighter {
    fn weight(&self, _: &u32, samples: &Arc<PageSamples>) -> u64 {
        CACHED_PAGE + samples.bytes() as u64
    }
}
