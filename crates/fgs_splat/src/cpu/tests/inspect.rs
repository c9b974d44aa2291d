//! What a pass leaves behind, for other backends to be compared with.

use std::collections::BTreeSet;

use fgs_geom::View;

use crate::Gaussians;
use crate::cpu::Rasterizer;
use crate::cpu::bounds::{
    BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS, TILE_COLUMNS, TILE_HEIGHT, TILE_WIDTH,
};
use crate::cpu::chunks::CHUNK;
use crate::cpu::project::SPLAT;

/// The gaussians that contribute to a pixel, each with its splat's values.
pub fn splats(gaussians: &Gaussians, view: &View) -> Vec<(u32, [f32; SPLAT])> {
    let mut rasterizer = Rasterizer::default();
    let contributing = rasterizer.render(gaussians, view).visible();
    let chunks = rasterizer.chunks.iter();
    chunks
        .flat_map(|chunk| chunk.visible.iter().zip(&chunk.splats))
        .filter(|(visible, _)| contributing.contains(&visible.gaussian))
        .map(|(visible, splat)| (visible.gaussian, splat.to_array()))
        .collect()
}

/// Pairs of a square tile, of that side, and a gaussian: first where one may contribute to a pixel,
/// then where one does.
pub fn tiles(gaussians: &Gaussians, view: &View, side: usize) -> [BTreeSet<(usize, u32)>; 2] {
    let mut rasterizer = Rasterizer::default();
    rasterizer.render(gaussians, view);
    let columns = view.camera.width.div_ceil(TILE_WIDTH);
    let mut pairs = [BTreeSet::new(), BTreeSet::new()];
    let lists = &rasterizer.lists;
    for (pairs, entries) in pairs.iter_mut().zip([&lists.dealt, &lists.entries]) {
        for (at, entry) in entries.iter().enumerate() {
            let chunk = &rasterizer.chunks[entry.splat as usize / CHUNK];
            let gaussian = chunk.visible[entry.splat as usize % CHUNK].gaussian;
            let tile = lists.starts.partition_point(|start| *start <= at) - 1;
            let (left, top) = (tile % columns * TILE_WIDTH, tile / columns * TILE_HEIGHT);
            for block in (0..BLOCKS).filter(|block| entry.blocks >> block & 1 == 1) {
                let column = (left + block % TILE_COLUMNS * BLOCK_WIDTH) / side;
                let row = (top + block / TILE_COLUMNS * BLOCK_HEIGHT) / side;
                pairs.insert((row * view.camera.width.div_ceil(side) + column, gaussian));
            }
        }
    }
    pairs
}
