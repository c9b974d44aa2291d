//! Records dispatches: all in one compute pass or, if they are timed, one pass for each.

use super::buffers::Buffers;
use super::device::GpuDevice;
use super::layout::{DISPATCH_WORDS, Dispatch};
use super::timer::StageTimer;
use crate::GpuError;

/// The size of a dispatch, workgroups.
#[derive(Clone, Copy, Debug)]
pub enum Groups {
    /// Along x and y.
    Fixed(u32, u32),
    /// By an indirect dispatch, from this entry of the buffer `dispatches`.
    Counted(Dispatch),
}

/// Commands being recorded.
pub struct Recorder<'a> {
    device: &'a GpuDevice,
    pub buffers: &'a mut Buffers,
    encoder: wgpu::CommandEncoder,
    pass: Option<wgpu::ComputePass<'static>>,
    timer: Option<&'a mut StageTimer>,
}

impl<'a> Recorder<'a> {
    /// Starts an empty command buffer.
    pub fn new(
        device: &'a GpuDevice,
        buffers: &'a mut Buffers,
        timer: Option<&'a mut StageTimer>,
    ) -> Self {
        Self {
            device,
            buffers,
            encoder: device.encoder(),
            pass: None,
            timer,
        }
    }

    /// Dispatches a stage, with its bindings resolved by name.
    pub fn run(&mut self, stage: &'static str, groups: Groups) -> Result<(), GpuError> {
        self.run_as(stage, 0, &[], groups)
    }

    /// Dispatches a stage with aliases for some bindings; see [`Buffers::bind`].
    pub fn run_as(
        &mut self,
        stage: &'static str,
        variant: usize,
        aliases: &[(&str, &str)],
        groups: Groups,
    ) -> Result<(), GpuError> {
        if let Some(timer) = &mut self.timer {
            self.pass = None;
            let writes = timer.next(stage);
            self.pass = Some(begin(&mut self.encoder, writes));
        }
        let pass = self
            .pass
            .get_or_insert_with(|| begin(&mut self.encoder, None));
        pass.set_pipeline(&self.device.stage(stage)?.pipeline);
        pass.set_bind_group(0, self.buffers.bind(stage, variant, aliases)?, &[]);
        match groups {
            Groups::Fixed(x, y) => pass.dispatch_workgroups(x, y, 1),
            Groups::Counted(place) => {
                let offset = 4 * u64::from(DISPATCH_WORDS) * place as u64;
                pass.dispatch_workgroups_indirect(self.buffers.get("dispatches")?, offset);
            }
        }
        Ok(())
    }

    /// The encoder, for other commands than dispatches. Ends the compute pass.
    pub fn encoder(&mut self) -> &mut wgpu::CommandEncoder {
        self.pass = None;
        &mut self.encoder
    }

    /// Submits the commands.
    pub fn submit(mut self) -> wgpu::SubmissionIndex {
        self.pass = None;
        if let Some(timer) = self.timer {
            timer.resolve(&mut self.encoder);
        }
        self.device.queue().submit([self.encoder.finish()])
    }
}

fn begin(
    encoder: &mut wgpu::CommandEncoder,
    timestamp_writes: Option<wgpu::ComputePassTimestampWrites<'_>>,
) -> wgpu::ComputePass<'static> {
    encoder
        .begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: None,
            timestamp_writes,
        })
        .forget_lifetime()
}
