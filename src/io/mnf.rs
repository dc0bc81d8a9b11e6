//! stub
use super::ReadError;
use crate::brick::*;
use crate::grid::*;
use crate::stage::indicator::*;
use std::fs::File;
use std::io;
use std::path::Path;
#[derive(Debug, Clone, Copy)]
pub struct FrameFacts {
    pub grid: Grid,
    pub domain: Option<Domain>,
    pub indicator: Indicator,
    pub side: BrickSide,
    pub census: Census,
}
use std::ops::Deref;
pub struct FrameWriter<W>(W);
impl<W: io::Write> FrameWriter<W> {
    pub fn create(f: W) -> io::Result<Self> {
        Ok(Self(f))
    }
    pub fn push<S: Deref<Target = [u16]> + Sync>(&mut self, _: &[(PageInfo, S)]) -> io::Result<()> {
        panic!()
    }
    pub fn finish(self, _: &FrameFacts) -> io::Result<File> {
        panic!()
    }
}
pub fn frame_from_file(_: File, _: u64) -> io::Result<DifField> {
    panic!()
}
pub fn open_frame(_: &Path, _: u64) -> Result<(FrameFacts, DifField), ReadError> {
    panic!()
}
