//! Images: compares every engine with the reference and the reference with other libraries, and checks the cost of
//! requests.

mod bundles;
mod echo;
mod embree;
mod engines;
mod gpu;
mod gpu_hiding;
mod gpu_render;
mod gpu_reuse;
mod hard_scenes;
mod indexes;
mod left_out;
mod lenses;
mod merged;
mod normal;
mod oracle;
mod ray_tables;
mod recovery;
mod small_polygons;
mod ways;
