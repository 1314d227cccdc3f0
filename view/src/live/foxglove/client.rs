//! One client: what it subscribes to, and what it was sent.

use std::collections::BTreeMap;
use std::io;
use std::pin::pin;
use std::sync::Arc;

use futures_util::future::{Either, select};

use super::board::{Board, Entered};
use super::protocol::{Asked, Subscription, Told, advertise, message_data};
use super::websocket::{Heard, Incoming, Socket};

/// Subscriptions of one client: several panels may show one topic.
const SUBSCRIPTIONS_MAX: usize = 256;

/// A subscription: the topic's place, and the number of the last message sent.
#[derive(Debug, Clone, Copy)]
struct Subscribed {
    place: usize,
    number: u64,
}

/// Serves one client until it leaves.
pub(super) async fn serve(mut socket: Socket, board: Arc<Board>, entered: Entered) {
    // Its end is no error of ours: the client closed, or its connection broke.
    let _ = follow(&mut socket, &board).await;
    drop(entered);
}

async fn follow(socket: &mut Socket, board: &Board) -> io::Result<()> {
    let session = std::process::id().to_string();
    let info = Told::ServerInfo {
        name: "vlaps",
        capabilities: [],
        supported_encodings: [],
        session_id: &session,
    };
    tell(socket, &info).await?;
    tell(socket, &advertise(board.channels())).await?;
    let mut subscribed = BTreeMap::<u32, Subscribed>::new();
    let mut news = board.listen();
    loop {
        let heard = {
            let (heard, changed) = (pin!(socket.hear()), pin!(news.changed()));
            match select(heard, changed).await {
                Either::Left((heard, _)) => Some(heard?),
                // The reader has ended, and so does the program.
                Either::Right((Err(_), _)) => return Ok(()),
                Either::Right((Ok(()), _)) => None,
            }
        };
        match heard {
            Some(Heard::Text(text)) => {
                if let Err(refused) = take(&mut subscribed, &text, board) {
                    let (level, message) = (1, refused);
                    tell(socket, &Told::Status { level, message }).await?;
                }
            }
            Some(Heard::Ping(bytes)) => socket.pong(&bytes).await?,
            Some(Heard::Close) => return socket.close().await,
            None => {}
        }
        for (id, subscribed) in &mut subscribed {
            send_newest(socket, board, (*id, subscribed)).await?;
        }
    }
}

/// What the bytes of a client come to, without a connection: subscriptions at the end, and
/// refused requests.
///
/// # Errors
/// When the client breaks the protocol.
pub fn take_all(bytes: &[u8], board: &Board) -> io::Result<(usize, usize)> {
    let mut incoming = Incoming::of(bytes);
    let (mut subscribed, mut refused) = (BTreeMap::new(), 0);
    while let Some(heard) = incoming.next()? {
        match heard {
            Heard::Text(text) => {
                refused += usize::from(take(&mut subscribed, &text, board).is_err())
            }
            Heard::Ping(_) => {}
            Heard::Close => break,
        }
    }
    Ok((subscribed.len(), refused))
}

/// Changes the subscriptions as a client asks.
fn take(
    subscribed: &mut BTreeMap<u32, Subscribed>,
    text: &str,
    board: &Board,
) -> Result<(), String> {
    let asked = serde_json::from_str(text);
    match asked.map_err(|_| "this server knows subscribe and unsubscribe alone".to_string())? {
        Asked::Subscribe { subscriptions } => {
            for Subscription { id, channel_id } in subscriptions {
                if channel_id >= board.channels().len() {
                    return Err(format!("there is no channel {channel_id}"));
                }
                if subscribed.len() >= SUBSCRIPTIONS_MAX {
                    return Err(format!("more than {SUBSCRIPTIONS_MAX} subscriptions"));
                }
                let (place, number) = (channel_id, 0);
                subscribed.insert(id, Subscribed { place, number });
            }
        }
        Asked::Unsubscribe { subscription_ids } => {
            for id in subscription_ids {
                subscribed.remove(&id);
            }
        }
    }
    Ok(())
}

/// Sends the newest message of a topic, unless the client has it; waits while the client has
/// no room, and this client alone.
async fn send_newest(
    socket: &mut Socket,
    board: &Board,
    (id, subscribed): (u32, &mut Subscribed),
) -> io::Result<()> {
    let Some(newest) = board.newest(subscribed.place) else {
        return Ok(());
    };
    if newest.number == subscribed.number {
        return Ok(());
    }
    let skipped = match subscribed.number {
        // What came before it subscribed is not missed.
        0 => 0,
        last => newest.number.saturating_sub(last + 1),
    };
    subscribed.number = newest.number;
    let bytes = message_data(id, newest.epoch_ns, &newest.cdr);
    socket.binary(&bytes).await?;
    board.count_sent(skipped);
    Ok(())
}

async fn tell(socket: &mut Socket, told: &Told<'_>) -> io::Result<()> {
    let text = serde_json::to_string(told).unwrap_or_default();
    socket.text(&text).await
}
