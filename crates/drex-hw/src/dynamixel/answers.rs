//! What several motors answered to one question.

use crate::{Error, Result};

/// Most motors that one packet asks.
const MOST: usize = 64;

/// Room for the answers of several motors to a read of the same length, kept from cycle to cycle.
#[derive(Debug, Clone)]
pub struct Answers {
    ids: Vec<u8>,
    len: usize,
    data: Vec<u8>,
    /// Error byte of each motor that answered.
    errors: Vec<Option<u8>>,
}

impl Answers {
    /// Room for `len` bytes of each of `ids`.
    ///
    /// # Errors
    /// If there are no or too many motors, one is named twice, or nothing is to be read.
    pub fn new(ids: &[u8], len: usize) -> Result<Self> {
        let twice = ids.iter().enumerate().find(|(i, id)| ids[..*i].contains(id) || **id > 252);
        if let Some((_, id)) = twice {
            return Err(Error::value(format!("motor {id} cannot be asked twice"), "name each of 0..=252 once"));
        }
        if ids.is_empty() || ids.len() > MOST || len == 0 || (len + 11) * ids.len() > 900 {
            return Err(Error::value(
                format!("a read of {len} bytes of {} motors", ids.len()),
                format!("read 1 byte or more of at most {MOST} motors, at most 900 bytes in all"),
            ));
        }
        Ok(Self { ids: ids.to_vec(), len, data: vec![0; ids.len() * len], errors: vec![None; ids.len()] })
    }

    /// Who is asked.
    pub fn ids(&self) -> &[u8] {
        &self.ids
    }

    /// Bytes that each motor is asked for.
    pub fn data_len(&self) -> usize {
        self.len
    }

    /// What motor number `index` answered: its error byte and its data.
    pub fn get(&self, index: usize) -> Option<(u8, &[u8])> {
        let error = (*self.errors.get(index)?)?;
        Some((error, &self.data[index * self.len..(index + 1) * self.len]))
    }

    /// How many answered.
    pub fn answered(&self) -> usize {
        self.errors.iter().flatten().count()
    }

    pub(super) fn clear(&mut self) {
        self.errors.fill(None);
    }

    /// Keeps an answer to a question that was put to the motors from `first` on; whether it was one.
    pub(super) fn keep(&mut self, first: usize, id: u8, error: u8, data: &[u8]) -> bool {
        let Some(index) = self.ids.iter().position(|i| *i == id).filter(|i| *i >= first) else { return false };
        if data.len() != self.len || self.errors[index].is_some() {
            return false;
        }
        self.data[index * self.len..(index + 1) * self.len].copy_from_slice(data);
        self.errors[index] = Some(error);
        true
    }

    /// The last motor that answered.
    pub(super) fn last(&self) -> Option<usize> {
        self.errors.iter().rposition(Option::is_some)
    }
}
