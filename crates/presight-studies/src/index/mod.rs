//! The paper's spatial indexes (section 2.2) and the default one, by their names in flags and files.
//!
//! | scheme | cells | a polygon is in | source |
//! |---|---|---|---|
//! | [`Scheme::Grid`] | equal squares | every cell it overlaps | paper section 2.2 |
//! | [`Scheme::Plop`] | slices of each axis at quantiles | the cell of its centroid | Kriegel and Seeger 1988 |
//! | [`Scheme::S2d`], [`Scheme::S3d`] | halves of halves | the leaf of its centroid | Ooi et al. 1987/1991 |
//! | [`Scheme::TwoLevel`] | a spatial-kD tree of objects over mesh trees | its mesh | `presight_model::index` |

mod cells;
mod exact;
mod grid;
mod plop;
#[cfg(test)]
mod tests;

pub use exact::polygon_meets;
pub use grid::Grid;
pub use plop::Plop;

use presight_model::error::{Error, Result};
use presight_model::geometry::Aabb;
use presight_model::index::{IndexKind, Params, Skd, SpatialIndex};

presight_model::words! {
    /// A method to find polygons.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub enum Scheme {
        /// No index: every cluster of every object is tested.
        None = "none",
        /// Uniform grid of square cells.
        Grid = "grid",
        /// Piecewise linear order preserving hashing.
        Plop = "plop",
        /// Spatial-kD tree over x and y.
        S2d = "s2d",
        /// Spatial-kD tree over x, y and z.
        S3d = "s3d",
        /// Spatial-kD tree of objects over one tree per mesh, in the mesh's own frame and shared by its instances.
        #[default]
        TwoLevel = "two-level",
    }
}

impl Scheme {
    /// The best parameters by `presight index --sweep` (benches/RESULTS.md).
    pub fn params(self) -> Params {
        match self {
            Self::Grid | Self::Plop => Params { cell_polygons: 32, ..Params::default() },
            Self::None | Self::S2d | Self::S3d | Self::TwoLevel => Params::default(),
        }
    }

    /// The index that a world gets by this scheme.
    pub fn kind(self, params: Params) -> IndexKind {
        IndexKind::Polygons(match self {
            Self::None => return IndexKind::None,
            Self::TwoLevel => return IndexKind::TwoLevel(params),
            Self::Grid => Box::new(Grid::build(params, &[])),
            Self::Plop => Box::new(Plop::build(params, &[])),
            Self::S2d => Box::new(Skd::<2>::build(params, &[])),
            Self::S3d => Box::new(Skd::<3>::build(params, &[])),
        })
    }

    /// [`Scheme::kind`] with the best parameters.
    pub fn tuned(self) -> IndexKind {
        self.kind(self.params())
    }

    /// An index over ids with these boxes; `None` for schemes that do not index polygons.
    pub fn build(self, params: Params, boxes: &[(u32, Aabb)]) -> Option<Box<dyn SpatialIndex>> {
        match self.kind(params) {
            IndexKind::Polygons(index) => Some(index.rebuilt(boxes)),
            IndexKind::None | IndexKind::TwoLevel(_) => None,
        }
    }
}

impl std::str::FromStr for Scheme {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let names = Self::ALL.map(Self::name).join(", ");
        let found = Self::ALL.into_iter().find(|s| s.name() == name);
        found.ok_or_else(|| Error::usage(format!("unknown index {name:?}"), format!("choose from {names}")))
    }
}
