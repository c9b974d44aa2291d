// Shared by the two loss passes.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> loss: Loss;
// Per pixel: RGB with 8 bits each and, in the fourth byte, 1 if the camera saw the colour, else 0;
// then the bits of the depth in metres.
@group(0) @binding(2) var<storage, read> measured: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> rendered: array<vec4<f32>>;
// [channel][3][pixel]: derivatives of the sum of 1 - SSIM with respect to windowed means: of d and s
// (their sum), of d^2, and of s^2.
@group(0) @binding(4) var<storage, read_write> moments: array<f32>;
// [3][workgroup]: sums of 1 - SSIM, of absolute colour errors and of absolute depth errors (m).
@group(0) @binding(5) var<storage, read_write> loss_sums: array<f32>;

// Side of a workgroup's block of pixels including the window's halo.
const PADDED: u32 = SIDE + 2u * RADIUS;

// Compares bits: shader compilers may assume that there is no NaN or infinity.
fn has_depth(bits: u32) -> bool {
    return bits > 0u && bits < 0x7f800000u;
}

fn is_valid(pixel: vec2<u32>) -> bool {
    return pixel.x >= 1u << 24u && (loss.masked == 0u || has_depth(pixel.y));
}

fn offset_of(channel: u32, map: u32) -> u32 {
    return (3u * channel + map) * view.width * view.height;
}
