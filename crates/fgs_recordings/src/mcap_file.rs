//! One MCAP file, read by its index: what it holds, and single messages of it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use fgs_data::DataError;
use mcap::sans_io::indexed_reader::{IndexedReadEvent, IndexedReader, IndexedReaderOptions};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{McapError, Summary};

use crate::fault::{fault, io_fault};

/// What a file begins with.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// A chunk, compressed or not: an image of 12 megapixels and what comes with it.
const MAX_RECORD_BYTES: usize = 256 * 1024 * 1024;

/// A file with its index.
pub(crate) struct McapFile {
    path: PathBuf,
    file: Mutex<File>,
    len: u64,
    summary: Summary,
}

impl McapFile {
    /// Whether a file begins like one.
    pub fn is_one(path: &Path) -> bool {
        let mut magic = [0; 8];
        fgs_files::open_regular(path)
            .and_then(|mut file| file.read_exact(&mut magic))
            .is_ok_and(|()| magic == MAGIC)
    }

    /// Opens one.
    ///
    /// # Errors
    /// If it is damaged or has no index.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        let mut file = fgs_files::open_regular(path).map_err(|source| io_fault(path, source))?;
        let metadata = file.metadata().map_err(|source| io_fault(path, source))?;
        let summary = read_summary(&mut file, metadata.len())
            .map_err(|error| damaged(path, &error))?
            .filter(|summary| !summary.chunk_indexes.is_empty());
        let Some(summary) = summary else {
            let message =
                "has no index, as of a recording that was cut off: `mcap recover` makes one";
            return Err(fault(path, message.into()));
        };
        Ok(Self {
            path: path.into(),
            file: Mutex::new(file),
            len: metadata.len(),
            summary,
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The topics of messages in CDR, with the names of their schemas.
    pub fn topics(&self) -> BTreeMap<String, String> {
        let channels = self.summary.channels.values();
        channels
            .filter(|channel| channel.message_encoding == "cdr")
            .filter_map(|channel| {
                let schema = channel.schema.as_ref()?;
                Some((channel.topic.clone(), schema.name.clone()))
            })
            .collect()
    }

    /// Calls `visit` for each message of some topics in the order of their log times, which are in
    /// nanoseconds, until it breaks off. `at` restricts them to one time.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn visit(
        &self,
        topics: &[&str],
        at: Option<u64>,
        mut visit: impl FnMut(&str, u64, &[u8]) -> ControlFlow<()>,
    ) -> Result<(), DataError> {
        let options = IndexedReaderOptions::new()
            .include_topics(topics.iter().copied())
            .with_record_length_limit(MAX_RECORD_BYTES);
        let options = match at {
            Some(time) => options.starting_at(time).ending_at(time),
            None => options,
        };
        let damage = |error: McapError| damaged(&self.path, &error);
        let mut reader = IndexedReader::new_with_options(&self.summary, options).map_err(damage)?;
        while let Some(event) = reader.next_event() {
            match event.map_err(damage)? {
                IndexedReadEvent::ReadChunkRequest { offset, length } => {
                    let bytes = self.read(offset, length)?;
                    reader
                        .insert_chunk_record_data(offset, &bytes)
                        .map_err(damage)?;
                }
                IndexedReadEvent::Message { header, data } => {
                    let channel = self.summary.channels.get(&header.channel_id);
                    // Without topics the reader would give all.
                    let topic = channel.map(|channel| channel.topic.as_str());
                    if let Some(topic) = topic.filter(|topic| topics.contains(topic))
                        && visit(topic, header.log_time, data).is_break()
                    {
                        return Ok(());
                    }
                }
            }
        }
        Ok(())
    }

    fn read(&self, offset: u64, length: usize) -> Result<Vec<u8>, DataError> {
        if offset.saturating_add(length as u64) > self.len {
            return Err(fault(&self.path, "the index leads beyond the end".into()));
        }
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let mut bytes = vec![0; length];
        file.seek(SeekFrom::Start(offset))
            .and_then(|_| file.read_exact(&mut bytes))
            .map_err(|source| io_fault(&self.path, source))?;
        Ok(bytes)
    }
}

fn read_summary(file: &mut File, len: u64) -> Result<Option<Summary>, McapError> {
    let options = SummaryReaderOptions::default()
        .with_file_size(len)
        .with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    Ok(reader.finish())
}

fn damaged(path: &Path, error: &McapError) -> DataError {
    fault(path, format!("the MCAP file is damaged: {error}"))
}
