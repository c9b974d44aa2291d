//! What takes part in DDS, and a node of ROS 2 in it.

use std::env;

use ros2_client::dds::rustdds::no_key::DataWriterCdr;
use ros2_client::dds::rustdds::{DomainParticipantBuilder, QosPolicies, Topic};
use ros2_client::qos::{Durability, History, QosProfile, Reliability, WhenFull};
use ros2_client::{Context, MessageTypeName, Node, NodeName, NodeOptions, Publisher};
use serde::Serialize;

use crate::error::Ros2Error;
use crate::raw_topic::RawReader;

/// Messages that wait for who reads a topic.
const WAITING: usize = 4;

/// Highest domain that ports are left for.
const MAX_DOMAIN: u16 = 232;

/// A place in a domain of DDS, from which topics are seen. Clones are of the same place.
#[derive(Clone)]
pub struct Domain {
    context: Context,
}

/// A topic that somebody publishes.
pub(crate) struct Published {
    /// ROS's name.
    pub topic: String,
    /// DDS's name of its type.
    pub type_name: String,
    pub is_reliable: bool,
}

/// A node of ROS 2, which publishes.
pub struct Ros2Node {
    domain: Domain,
    node: Node,
}

impl Domain {
    /// The domain that `ROS_DOMAIN_ID` names, 0 without.
    ///
    /// # Errors
    /// If that is none, or DDS cannot start.
    pub fn of_environment() -> Result<Self, Ros2Error> {
        let Some(text) = env::var_os("ROS_DOMAIN_ID").filter(|text| !text.is_empty()) else {
            return Self::new(0);
        };
        let text = text.to_string_lossy();
        match text.parse() {
            Ok(number) if number <= MAX_DOMAIN => Self::new(number),
            _ => Err(Ros2Error::Domain(text.into())),
        }
    }

    /// A domain by its number.
    ///
    /// # Errors
    /// If DDS cannot start.
    pub fn new(number: u16) -> Result<Self, Ros2Error> {
        let participant = DomainParticipantBuilder::new(number).build();
        let participant = participant.map_err(Ros2Error::ros)?;
        let context = Context::from_domain_participant(participant).map_err(Ros2Error::ros)?;
        Ok(Self { context })
    }

    /// Reads a topic's messages as they are, as reliably as they are published.
    pub(crate) fn reader(
        &self,
        topic: &str,
        message: (&str, &str),
        is_reliable: bool,
    ) -> Result<RawReader, Ros2Error> {
        let qos = qos(is_reliable, WAITING, Durability::Volatile);
        let topic = self.topic(topic, message, &qos)?;
        let qos = QosPolicies::from(qos);
        let subscriber = self.context.domain_participant().create_subscriber(&qos);
        subscriber
            .map_err(Ros2Error::ros)?
            .create_simple_datareader_no_key(&topic, Some(qos))
            .map_err(Ros2Error::ros)
    }

    /// Publishes a topic whose last message also comes to those who come later, and tells when it has come.
    pub(crate) fn latched<M: Serialize>(
        &self,
        topic: &str,
        message: (&str, &str),
    ) -> Result<DataWriterCdr<M>, Ros2Error> {
        let qos = qos(true, 1, Durability::TransientLocal);
        let topic = self.topic(topic, message, &qos)?;
        let qos = QosPolicies::from(qos);
        let publisher = self.context.domain_participant().create_publisher(&qos);
        publisher
            .map_err(Ros2Error::ros)?
            .create_datawriter_no_key(&topic, Some(qos))
            .map_err(Ros2Error::ros)
    }

    /// What others publish now.
    pub(crate) fn published(&self) -> Vec<Published> {
        let writers = self.context.domain_participant().discovered_writers();
        let topics = writers.iter().filter_map(|writer| {
            let data = &writer.publication_topic_data;
            let qos = QosProfile::from(&data.qos());
            Some(Published {
                topic: data.topic_name().strip_prefix("rt")?.into(),
                type_name: data.type_name.clone(),
                is_reliable: qos.reliability != Reliability::BestEffort,
            })
        });
        topics.collect()
    }

    /// Whether anybody else reads a topic.
    pub fn is_read(&self, topic: &str) -> bool {
        let readers = self.context.domain_participant().discovered_readers();
        let names = readers
            .iter()
            .map(|reader| reader.subscription_topic_data.topic_name());
        let mut names = names.filter_map(|name| name.strip_prefix("rt"));
        names.any(|name| name == topic)
    }

    fn topic(
        &self,
        topic: &str,
        (package, name): (&str, &str),
        qos: &QosProfile,
    ) -> Result<Topic, Ros2Error> {
        let message = MessageTypeName::new(package, name);
        self.context
            .create_topic(format!("rt{topic}"), message, qos)
            .map_err(Ros2Error::ros)
    }
}

impl Ros2Node {
    /// A node of some name.
    ///
    /// # Errors
    /// If the name is none, or DDS refuses.
    pub fn new(domain: &Domain, name: &str) -> Result<Self, Ros2Error> {
        let name = NodeName::new("/", name).map_err(Ros2Error::ros)?;
        let options = NodeOptions::new().enable_rosout(false);
        let node = domain.context.new_node(name, options);
        Ok(Self {
            domain: domain.clone(),
            node: node.map_err(Ros2Error::ros)?,
        })
    }

    /// Publishes a topic of a package's type, reliably.
    ///
    /// # Errors
    /// If DDS refuses.
    pub fn publisher<M: Serialize>(
        &mut self,
        topic: &str,
        message: (&str, &str),
    ) -> Result<Publisher<M>, Ros2Error> {
        let qos = qos(true, WAITING, Durability::Volatile);
        let topic = self.domain.topic(topic, message, &qos)?;
        let publisher = self.node.create_publisher(&topic, Some(qos));
        publisher.map_err(Ros2Error::ros)
    }
}

fn qos(is_reliable: bool, depth: usize, durability: Durability) -> QosProfile {
    QosProfile {
        reliability: if is_reliable {
            Reliability::Reliable {
                when_full: WhenFull::DEFAULT,
            }
        } else {
            Reliability::BestEffort
        },
        durability,
        history: History::KeepLast { depth },
        ..QosProfile::default()
    }
}
