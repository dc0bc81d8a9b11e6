//! The storage of a field's samples, in memory or elsewhere. Pages that are stored elsewhere are
//! cached in memory.

use std::borrow::Cow;
use std::fmt::Debug;
use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use quick_cache::sync::Cache;
use quick_cache::{OptionsBuilder, Weighter};

use super::{PageSamples, PageShape, RemotePages};

/// Bytes of a cached page in addition to its samples: its entry in the cache, and its allocation
/// headers.
const CACHED_PAGE: u64 = 136;

/// Samples that are read or computed page by page.
pub trait PageSource: Send + Sync + Debug {
    /// The stored samples of page number `page`, read or computed anew by each call.
    fn samples(&self, page: usize) -> Vec<u16>;
}

/// Number of remote pages that are fetched together, because neighbouring pages are often needed
/// together.
const PAGES_PER_FETCH: usize = 64;

/// A page in memory: in the field itself, or in its cache.
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
    /// Pages outside the host's memory. When the host needs one of them, it fetches the group of
    /// [`PAGES_PER_FETCH`] pages that contains it, and keeps the group.
    Remote {
        pages: Box<dyn RemotePages>,
        fallback: Box<dyn PageSource>,
        fetched: Vec<OnceLock<Vec<PageSamples>>>,
    },
}

impl PageStore {
    /// Pages of at most `mean_bytes` on average. Recently used pages stay in memory, up to
    /// `cache_bytes`.
    pub(super) fn paged(source: Box<dyn PageSource>, cache_bytes: u64, mean_bytes: u64) -> Self {
        let items = cache_bytes / (mean_bytes + CACHED_PAGE);
        let options = OptionsBuilder::new()
            .estimated_items_capacity(items as usize)
            .weight_capacity(cache_bytes)
            .build()
            .expect("every option without a default is set");
        let cache =
            Cache::with_options(options, PageWeighter, Default::default(), Default::default());
        Self::Paged { source, cache }
    }

    /// Pages outside the host's memory; if fetching fails, `fallback` computes them.
    pub(super) fn remote(pages: Box<dyn RemotePages>, fallback: Box<dyn PageSource>) -> Self {
        let fetched = std::iter::repeat_with(OnceLock::new)
            .take(pages.count().div_ceil(PAGES_PER_FETCH))
            .collect();
        Self::Remote { pages, fallback, fetched }
    }

    /// Maximum number of bytes of pages in memory; `None` for no limit.
    pub(super) fn cache_bytes(&self) -> Option<u64> {
        match self {
            Self::Memory(_) | Self::Remote { .. } => None,
            Self::Paged { cache, .. } => Some(cache.capacity()),
        }
    }

    /// Returns a page, and keeps it in memory because it is likely to be needed again soon.
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
            Self::Remote { .. } => CachedPage::Own(self.fetched(page as usize, shape)),
        }
    }

    /// Returns a page that is read only once, without evicting other pages from the cache.
    pub(super) fn once(&self, page: usize, shape: PageShape) -> Cow<'_, [u16]> {
        match self {
            Self::Memory(pages) => pages[page].dense(shape),
            Self::Paged { source, .. } => source.samples(page).into(),
            Self::Remote { .. } => self.fetched(page, shape).dense(shape),
        }
    }

    /// Returns a remote page, which is fetched with the other pages of its group at the first
    /// access.
    ///
    /// # Panics
    /// If the pages are not remote.
    fn fetched(&self, page: usize, shape: PageShape) -> &PageSamples {
        let Self::Remote { pages, fallback, fetched } = self else {
            unreachable!("the pages are remote")
        };
        let (group, first) =
            (&fetched[page / PAGES_PER_FETCH], page / PAGES_PER_FETCH * PAGES_PER_FETCH);
        let in_group = group.get().unwrap_or_else(|| {
            let range = first..pages.count().min(first + PAGES_PER_FETCH);
            let computed = |page| PageSamples::new(fallback.samples(page).into(), shape);
            let samples =
                pages.samples(range.clone()).unwrap_or_else(|| range.map(computed).collect());
            // Two threads may fetch the same group. A lock would prevent this, but could cause a
            // deadlock: while the thread that holds the lock waits for parallel work, it may run
            // another task, which may wait for the same lock.
            group.get_or_init(|| samples)
        });
        &in_group[page - first]
    }
}

/// Weighs pages by their memory.
#[derive(Debug, Clone)]
pub(super) struct PageWeighter;

impl Weighter<u32, Arc<PageSamples>> for PageWeighter {
    fn weight(&self, _: &u32, samples: &Arc<PageSamples>) -> u64 {
        CACHED_PAGE + samples.bytes() as u64
    }
}
