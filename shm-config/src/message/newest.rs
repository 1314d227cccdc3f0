use super::Message;

/// Room for the newest message of a service.
///
/// It is filled in place, and with no more than a message uses: at 100 Hz, where the caches
/// are cold at each tick, a tick does not touch the beams that the scanner does not have.
#[derive(Debug, Clone, Copy, Default)]
pub struct Newest<M> {
    message: M,
    is_there: bool,
}

impl<M: Message> Newest<M> {
    /// The message; `None` when there is none.
    pub fn get(&self) -> Option<&M> {
        self.is_there.then_some(&self.message)
    }

    /// The message, to be changed.
    pub fn get_mut(&mut self) -> Option<&mut M> {
        self.is_there.then_some(&mut self.message)
    }

    /// Keeps a copy of the message in place of the last one.
    pub fn keep(&mut self, message: &M) {
        self.message.assign(message);
        self.is_there = true;
    }

    /// Forgets the message.
    pub fn clear(&mut self) {
        self.is_there = false;
    }
}

impl<M: Message> From<M> for Newest<M> {
    fn from(message: M) -> Self {
        Self {
            message,
            is_there: true,
        }
    }
}

impl<M: Message + Default> From<Option<M>> for Newest<M> {
    fn from(message: Option<M>) -> Self {
        Self {
            is_there: message.is_some(),
            message: message.unwrap_or_default(),
        }
    }
}
