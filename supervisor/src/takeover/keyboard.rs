//! Keys from the terminal of the supervisor.

use std::io::{self, IsTerminal, Stdin};

use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::getpgrp;
use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcgetpgrp, tcsetattr,
};
use rustix::time::Timespec;

use crate::cli::failure::Failure;
use crate::takeover::key::Key;

/// Bytes read at once: far more than a held key sends between two reads; pasted text beyond
/// that comes with the next read.
const READ_MAX: usize = 256;

/// A terminal that delivers each key immediately and without echo. Dropping it restores the
/// terminal mode: at the end, after an error, in a panic.
#[derive(Debug)]
pub struct Keyboard {
    stdin: Stdin,
    before: Termios,
    decoder: Decoder,
}

impl Keyboard {
    /// Changes the terminal mode.
    ///
    /// # Errors
    /// When stdin is no terminal, or another program is in its foreground.
    pub fn open() -> Result<Self, Failure> {
        let refused = |why: &str| {
            Failure::Usage(format!(
                "--gate human: {why}, so no takeover is possible; run it in the foreground of a \
                 terminal, or give the keys with --keys FILE"
            ))
        };
        let stdin = io::stdin();
        if !stdin.is_terminal() {
            return Err(refused("stdin is no terminal"));
        }
        if !is_in_foreground(&stdin) {
            return Err(refused("the terminal is another program's"));
        }
        let before = tcgetattr(&stdin).map_err(|error| refused(&error.to_string()))?;
        let mut keys = before.clone();
        // ISIG and OPOST stay: Ctrl-C still stops, lines still begin at the left.
        keys.local_modes
            .remove(LocalModes::ICANON | LocalModes::ECHO | LocalModes::IEXTEN);
        // A read returns immediately, with or without a key. O_NONBLOCK would also affect
        // stdout, which usually is the same open file.
        keys.special_codes[SpecialCodeIndex::VMIN] = 0;
        keys.special_codes[SpecialCodeIndex::VTIME] = 0;
        tcsetattr(&stdin, OptionalActions::Now, &keys)
            .map_err(|error| refused(&error.to_string()))?;
        Ok(Self {
            stdin,
            before,
            decoder: Decoder::default(),
        })
    }

    /// The keys since the last read. Never blocks. Putting the supervisor into the background
    /// ends a takeover.
    pub fn read(&mut self) -> Vec<Key> {
        // A read from the background would stop the supervisor.
        if !is_in_foreground(&self.stdin) {
            self.decoder = Decoder::default();
            return vec![Key::GiveBack];
        }
        let mut bytes = [0; READ_MAX];
        let count = match is_readable(&self.stdin) {
            true => rustix::io::read(&self.stdin, &mut bytes).unwrap_or(0),
            false => 0,
        };
        self.decoder.decode(&bytes[..count])
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        // In the background the terminal belongs to another program.
        if is_in_foreground(&self.stdin) {
            // Unread keys must not reach the shell.
            let _ = tcsetattr(&self.stdin, OptionalActions::Flush, &self.before);
        }
    }
}

fn is_in_foreground(stdin: &Stdin) -> bool {
    tcgetpgrp(stdin).is_ok_and(|group| group == getpgrp())
}

/// Checked before each read: another program may have changed the terminal so that reads
/// wait for a line.
fn is_readable(stdin: &Stdin) -> bool {
    let mut stdin = [PollFd::new(stdin, PollFlags::IN)];
    let no_time = Timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    poll(&mut stdin, Some(&no_time)).is_ok_and(|ready| ready > 0)
}

/// Decodes the bytes of a terminal into keys.
#[derive(Debug, Default)]
pub struct Decoder {
    within: Within,
}

/// Where in an escape sequence the bytes are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Within {
    #[default]
    Nothing,
    /// After Esc: the key itself, or the start of another key's sequence.
    Escape,
    /// After `Esc [` or `Esc O`.
    Sequence,
}

impl Decoder {
    /// The keys in the bytes since the last read, which may be empty: an Esc without a
    /// following byte until the next read is the key Esc.
    pub fn decode(&mut self, bytes: &[u8]) -> Vec<Key> {
        if bytes.is_empty() && self.within == Within::Escape {
            self.within = Within::Nothing;
            return vec![Key::GiveBack];
        }
        bytes.iter().filter_map(|byte| self.take(*byte)).collect()
    }

    fn take(&mut self, byte: u8) -> Option<Key> {
        let (within, key) = match (self.within, byte) {
            (Within::Escape, b'[' | b'O') => (Within::Sequence, None),
            // Esc twice, or a key pressed with Alt: neither is a driving key.
            (Within::Escape, 0x1b) => (Within::Escape, Some(Key::GiveBack)),
            (Within::Escape, _) => (Within::Nothing, Some(Key::GiveBack)),
            (_, 0x1b) => (Within::Escape, None),
            // Parameter bytes before the last byte encode modifiers.
            (Within::Sequence, 0x20..=0x3f) => (Within::Sequence, None),
            (Within::Sequence, byte) => (Within::Nothing, arrow(byte)),
            (Within::Nothing, byte) => (Within::Nothing, plain(byte)),
        };
        self.within = within;
        key
    }
}

fn arrow(byte: u8) -> Option<Key> {
    match byte {
        b'A' => Some(Key::Gas),
        b'B' => Some(Key::Brake),
        b'C' => Some(Key::Right),
        b'D' => Some(Key::Left),
        _ => None,
    }
}

fn plain(byte: u8) -> Option<Key> {
    match byte.to_ascii_lowercase() {
        b' ' => Some(Key::Switch),
        b'q' => Some(Key::GiveBack),
        b'w' => Some(Key::Gas),
        b's' => Some(Key::Brake),
        b'a' => Some(Key::Left),
        b'd' => Some(Key::Right),
        _ => None,
    }
}
