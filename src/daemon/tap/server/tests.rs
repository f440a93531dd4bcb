use super::super::Valve;
use super::*;
use crate::capture::record::ring::ring;

#[test]
fn what_came_through_two_threads_is_carried_in_the_order_of_arrival() {
    let (stream, _reader) = UnixStream::pair().unwrap();
    let client = Client {
        stage: Stage::Streaming("roof".to_owned()),
        ..Client::new(stream).unwrap()
    };
    let mut clients = vec![client];
    clients[0].waiting.reserve(WAITING_BYTES);
    let (mut inlets, mut sensors) = (Vec::new(), Vec::new());
    for _ in 0..2 {
        let (producer, consumer) = ring(8192);
        let (name, valve) = ("roof".to_owned(), Arc::<Valve>::default());
        inlets.push(producer);
        sensors.push(Tapped {
            name,
            consumer,
            end: 0,
            valve,
            refused: 0,
        });
    }
    let end = "127.0.0.1:2368".parse().unwrap();
    let put = |producer: &mut crate::capture::record::ring::Producer, arrival_ns| {
        assert!(producer.put(&Addressed {
            arrival_ns,
            source: end,
            destination: end,
            payload: b"x"
        }));
    };
    [1, 4, 5]
        .into_iter()
        .for_each(|arrival_ns| put(&mut inlets[0], arrival_ns));
    [2, 3, 6]
        .into_iter()
        .for_each(|arrival_ns| put(&mut inlets[1], arrival_ns));
    carry(&mut sensors, &mut clients);
    let expected: Vec<u8> = (1..=6)
        .flat_map(|arrival_ns| {
            let one = Addressed {
                arrival_ns,
                source: end,
                destination: end,
                payload: b"x",
            };
            let (head, payload) = Frame::parts(&one).unwrap();
            [&head[..], payload].concat()
        })
        .collect();
    assert_eq!(clients[0].waiting, expected);
}
#[test]
fn a_client_that_keeps_up_makes_use_of_little_memory_however_long_it_stays() {
    let (stream, mut reader) = UnixStream::pair().unwrap();
    let mut client = Client {
        stage: Stage::Streaming("roof".to_owned()),
        ..Client::new(stream).unwrap()
    };
    client.waiting.reserve_exact(1 << 20);
    let end = "127.0.0.1:2368".parse().unwrap();
    let datagram = Addressed {
        arrival_ns: 1,
        source: end,
        destination: end,
        payload: &[7; 1206],
    };
    let mut places = std::collections::HashSet::new();
    let mut taken = vec![0; 4096];
    for _ in 0..2000 {
        client.put(&datagram);
        places.insert(client.waiting.as_slices().0.as_ptr());
        client.send();
        assert!(client.waiting.is_empty() && reader.read(&mut taken).unwrap() > 1206);
    }
    assert_eq!(places.len(), 1, "each begins where the one before did");
}
