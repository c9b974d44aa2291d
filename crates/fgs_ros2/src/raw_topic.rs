//! A topic whose messages are taken as they come: images are megabytes, and `fgs_recordings` reads them.

use std::convert::Infallible;

use ros2_client::dds::rustdds::RepresentationIdentifier;
use ros2_client::dds::rustdds::no_key::{
    Decode, DefaultDecoder, DeserializerAdapter, SimpleDataReader,
};

/// Hands on messages in CDR, with the four bytes before them that say in which order of bytes.
pub(crate) struct Raw;

/// The same for one message.
#[derive(Clone)]
pub(crate) struct RawDecoder;

/// Reads a topic.
pub(crate) type RawReader = SimpleDataReader<Vec<u8>, Raw>;

impl DeserializerAdapter<Vec<u8>> for Raw {
    type Error = Infallible;
    type Decoded = Vec<u8>;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[
            RepresentationIdentifier::CDR_LE,
            RepresentationIdentifier::CDR_BE,
        ]
    }

    fn transform_decoded(decoded: Vec<u8>) -> Vec<u8> {
        decoded
    }
}

impl DefaultDecoder<Vec<u8>> for Raw {
    type Decoder = RawDecoder;
    const DECODER: RawDecoder = RawDecoder;
}

impl Decode<'_, Vec<u8>> for RawDecoder {
    type Error = Infallible;

    fn decode_bytes(
        self,
        bytes: &[u8],
        encoding: RepresentationIdentifier,
    ) -> Result<Vec<u8>, Infallible> {
        let is_little_endian = encoding == RepresentationIdentifier::CDR_LE;
        Ok([&[0, u8::from(is_little_endian), 0, 0], bytes].concat())
    }
}
