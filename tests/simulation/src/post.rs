//! Questions across the simulated network. The network carries only the number of a question; what is asked and what is answered
//! stays in memory, so that nothing has to be written as bytes twice.

use crate::faults::Faults;
use futures::future::BoxFuture;
use std::any::Any;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use turmoil::net::{TcpListener, TcpStream};

/// Where every host listens.
const PORT: u16 = 7411;

type Answer = Box<dyn Any + Send>;
type Question<C> = Box<dyn FnOnce(C) -> BoxFuture<'static, Answer> + Send>;

/// Questions to hosts that answer with a `C`.
pub struct Post<C>(Mutex<Letters<C>>);

struct Letters<C> {
    next: u64,
    questions: BTreeMap<u64, Question<C>>,
    answers: BTreeMap<u64, Answer>,
}

/// No answer came.
#[derive(Debug)]
pub struct NoAnswer;

impl<C> Default for Post<C> {
    fn default() -> Self {
        Self(Mutex::new(Letters {
            next: 0,
            questions: BTreeMap::new(),
            answers: BTreeMap::new(),
        }))
    }
}

impl<C: Clone + Send + 'static> Post<C> {
    fn letters(&self) -> MutexGuard<'_, Letters<C>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks a host and waits for its answer. Without one the question may have been carried out, may be later, or never is.
    ///
    /// # Errors
    /// [`NoAnswer`] after `patience`, or where the connection breaks.
    pub async fn ask<T: Send + 'static>(
        &self,
        host: &str,
        patience: Duration,
        question: impl FnOnce(C) -> BoxFuture<'static, T> + Send + 'static,
    ) -> Result<T, NoAnswer> {
        let number = {
            let mut letters = self.letters();
            letters.next += 1;
            let (number, asked) = (letters.next, question);
            let boxed: Question<C> = Box::new(move |context| {
                let answer = asked(context);
                Box::pin(async move { Box::new(answer.await) as Answer })
            });
            letters.questions.insert(number, boxed);
            number
        };
        let sent = async {
            let mut stream = TcpStream::connect((host, PORT)).await?;
            stream.write_u64(number).await?;
            stream.read_u64().await
        };
        match tokio::time::timeout(patience, sent).await {
            Ok(Ok(_)) => {}
            _ => return Err(NoAnswer),
        }
        let answer = self.letters().answers.remove(&number).ok_or(NoAnswer)?;
        answer.downcast().map(|answer| *answer).map_err(|_| NoAnswer)
    }

    /// Answers what is asked of this host, each question in a task of its own.
    pub async fn serve(self: Arc<Self>, context: C, faults: Faults) -> turmoil::Result {
        let listener = TcpListener::bind(("0.0.0.0", PORT)).await?;
        loop {
            let (stream, _) = listener.accept().await?;
            let (post, context, faults) = (Arc::clone(&self), context.clone(), faults.clone());
            tokio::spawn(async move { post.answer(stream, context, &faults).await });
        }
    }

    async fn answer(&self, mut stream: TcpStream, context: C, faults: &Faults) {
        let Ok(number) = stream.read_u64().await else { return };
        let Some(question) = self.letters().questions.remove(&number) else {
            return;
        };
        let fate = faults.fate();
        tokio::time::sleep(fate.before).await;
        if fate.loses_question {
            return;
        }
        let answer = question(context).await;
        tokio::time::sleep(fate.after).await;
        if fate.loses_answer {
            return;
        }
        self.letters().answers.insert(number, answer);
        let _ = stream.write_u64(number).await;
    }
}
