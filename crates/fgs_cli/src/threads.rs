//! `--threads`: the number of threads that compute. Results do not depend on it.

use anyhow::Context;
use clap::Args;

/// The option, shared by every subcommand that computes.
#[derive(Clone, Copy, Debug, Args)]
pub struct Threads {
    /// Number of threads [default: one per core]; results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

impl Threads {
    /// Sets the number of threads of the whole program. Call it once, before anything is computed.
    ///
    /// # Errors
    /// If the threads cannot be started.
    pub fn apply(self) -> anyhow::Result<()> {
        let Some(threads) = self.threads else {
            return Ok(());
        };
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads.into())
            .build_global()
            .with_context(|| format!("cannot start {threads} threads"))
    }
}
