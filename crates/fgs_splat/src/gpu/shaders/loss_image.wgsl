// What both passes of the loss read. A measured pixel holds its colour, eight bits a channel with
// the fourth byte 0 where the camera did not see it, and the bits of its depth in metres.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> loss: Loss;
@group(0) @binding(2) var<storage, read> measured: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> rendered: array<vec4<f32>>;
// Of three values for each channel, a plane of pixels each: derivatives of the sum of 1 - SSIM by
// the windowed mean of d and s together and by the windowed means of d^2 and s^2.
@group(0) @binding(4) var<storage, read_write> moments: array<f32>;
// Per workgroup, a plane each: sums of 1 - SSIM, of the absolute errors of colour, and of depth.
@group(0) @binding(5) var<storage, read_write> loss_sums: array<f32>;

// Pixels along each side of a workgroup, those around it included that a window reaches.
const PADDED: u32 = SIDE + 2u * RADIUS;

// Compares bits: a shader may take it that there is no NaN or infinity.
fn has_depth(bits: u32) -> bool {
    return bits > 0u && bits < 0x7f800000u;
}

fn is_valid(pixel: vec2<u32>) -> bool {
    return pixel.x >= 1u << 24u && (loss.masked == 0u || has_depth(pixel.y));
}

fn offset_of(channel: u32, map: u32) -> u32 {
    return (3u * channel + map) * view.width * view.height;
}
