//! The surfaces of all blocks as a mesh in pieces, a block each.

use std::borrow::Cow;
use std::io;

use crate::surface::mesh::source::{Indexed, MeshSource, Outline, Vertices};

use super::Stitched;
use super::coarse::Coarse;

impl MeshSource for Stitched {
    fn outline(&self) -> Outline {
        Outline {
            vertices: self.spool.vertices(),
            triangles: self.spool.triangles(),
            normals: self.spool.has_normals(),
            attributes: self.attributes.clone(),
            pieces: self.spool.len(),
        }
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let block = self.spool.get(piece)?;
        let positions = self.positions(&block).into();
        Ok(match block {
            Cow::Borrowed(block) => Vertices {
                positions,
                normals: (&block.normals).into(),
                attributes: block.attributes.iter().map(Into::into).collect(),
            },
            Cow::Owned(block) => Vertices {
                positions,
                normals: block.normals.into(),
                attributes: block.attributes.into_iter().map(Into::into).collect(),
            },
        })
    }

    fn coarser(&self) -> io::Result<Option<Box<dyn MeshSource + '_>>> {
        Ok(Some(Box::new(Coarse::new(self)?)))
    }

    fn at_once(&self) -> io::Result<Option<Indexed>> {
        u32::try_from(self.vertex_count()).is_ok().then(|| self.positions_and_triangles()).transpose()
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        let mut triangles = Vec::with_capacity(self.spool.counts(piece)[1]);
        self.emit(piece, |_, _, triangle| triangles.push(triangle))?;
        Ok(triangles)
    }
}
