//! How many images fit: a run takes no more than 2 GB for images of up to 12 megapixels, whatever its
//! length, and keyframes no more than a quarter of the machine's memory. Where there are 6 GB, only images above
//! a megapixel are affected.

use fgs_geom::Camera;

use crate::machine_memory::machine_memory;

/// What a run may take beside its map.
const BUDGET_BYTES: usize = 2 << 30;

/// Frames that are decoded ahead (fgs_data) or wait for the mapper, and the program with a small map.
const FIXED_BYTES: usize = 512 << 20;

/// Of it for frames that wait for the mapper.
const WAITING_BYTES: usize = 128 << 20;

/// Colour and depth.
const IMAGES_BYTES_PER_PIXEL: usize = 3 + 4;

/// Rendering and its derivative (48), the frames that the tracker remembers, images being decoded.
const WORK_BYTES_PER_PIXEL: usize = 48 + 3 * IMAGES_BYTES_PER_PIXEL + 24;

/// How many keyframes' images there is room for: two at least, or there is nothing to optimise.
pub fn keyframes(camera: &Camera) -> usize {
    keyframes_within(machine_memory(), camera)
}

fn keyframes_within(memory_bytes: u64, camera: &Camera) -> usize {
    let quarter = usize::try_from(memory_bytes / 4).unwrap_or(usize::MAX);
    let work = WORK_BYTES_PER_PIXEL.saturating_mul(pixels(camera));
    let room = (BUDGET_BYTES - FIXED_BYTES).min(quarter);
    let room = room.saturating_sub(work);
    (room / images_bytes(camera)).max(2)
}

/// How many frames may wait for the mapper: one at least, or it would get none.
pub fn waiting_frames(camera: &Camera) -> usize {
    (WAITING_BYTES / images_bytes(camera)).max(1)
}

fn images_bytes(camera: &Camera) -> usize {
    IMAGES_BYTES_PER_PIXEL.saturating_mul(pixels(camera).max(1))
}

fn pixels(camera: &Camera) -> usize {
    camera.width.saturating_mul(camera.height)
}

#[cfg(test)]
mod tests {
    use fgs_geom::Intrinsics;

    use super::*;

    fn camera(width: usize, height: usize) -> Camera {
        let focal = width as f64;
        let intrinsics = Intrinsics {
            fx: focal,
            fy: focal,
            cx: 0.0,
            cy: 0.0,
        };
        Camera::new(width, height, intrinsics).unwrap()
    }

    #[test]
    fn usual_images_are_not_limited_and_large_ones_fit() {
        for (width, height) in [(640, 480), (1200, 680), (1280, 720)] {
            assert!(keyframes_within(6 << 30, &camera(width, height)) >= 200);
            assert!(waiting_frames(&camera(width, height)) >= 10);
        }
        let large = camera(4000, 3000);
        assert_eq!(
            (keyframes_within(8 << 30, &large), waiting_frames(&large)),
            (5, 1)
        );
        let huge = camera(65536, 65536);
        assert_eq!(
            (keyframes_within(8 << 30, &huge), waiting_frames(&huge)),
            (2, 1)
        );
    }

    #[test]
    fn a_small_machine_keeps_fewer() {
        let usual = camera(640, 480);
        assert_eq!(keyframes_within(2 << 30, &usual), 236);
        assert_eq!(keyframes_within(1 << 30, &usual), 111);
    }
}
