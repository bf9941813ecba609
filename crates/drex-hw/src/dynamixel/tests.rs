//! The codec against the manual's packets, random packets and hostile bytes.

use proptest::prelude::*;

use super::*;

fn parse_all(bytes: &[u8]) -> Vec<(u8, u8, Vec<u8>)> {
    let (mut parser, mut found, mut rest) = (Parser::new(), Vec::new(), bytes);
    loop {
        while let Some(p) = parser.next_packet() {
            found.push((p.id, p.instruction, p.params.to_vec()));
        }
        if rest.is_empty() {
            if parser.give_up() {
                continue;
            }
            return found;
        }
        let taken = parser.push(rest);
        assert!(taken > 0, "a parser that has given all it has takes more");
        rest = &rest[taken..];
    }
}

fn packet(id: u8, instruction: u8, params: &[u8]) -> Vec<u8> {
    let mut buffer = [0; 1024];
    let n = encode(&mut buffer, id, instruction, params).expect("fits");
    buffer[..n].to_vec()
}

/// A fast reply as motors send it.
fn fast_reply(blocks: &[(u8, u8, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = HEADER.to_vec();
    bytes.push(BROADCAST);
    let length = 1 + blocks.iter().map(|b| b.2.len() + 4).sum::<usize>();
    bytes.extend((length as u16).to_le_bytes());
    bytes.push(instruction::STATUS);
    for (id, error, data) in blocks {
        bytes.extend([*error, *id]);
        bytes.extend(data);
        bytes.extend(crc16(0, &bytes).to_le_bytes());
    }
    bytes
}

fn hex(text: &str) -> Vec<u8> {
    (0..text.len() / 2).map(|i| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).expect("hex")).collect()
}

#[test]
fn packets_of_the_manual_byte_by_byte() {
    let Some(shared) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: set DREX_SHARED to the folder that holds data/golden/dynamixel");
        return;
    };
    let file = std::path::Path::new(&shared).join("data/golden/dynamixel/vectors.json");
    let text = std::fs::read_to_string(&file).expect("the vectors are in DREX_SHARED");
    let all: serde_json::Value = serde_json::from_str(&text).expect("json");
    let mut seen = [0; 3];
    for v in all["vectors"].as_array().expect("a list") {
        let (bytes, name) = (hex(v["hex"].as_str().expect("hex")), v["name"].as_str().expect("name"));
        let id = v["id"].as_u64().unwrap_or(0) as u8;
        match v["kind"].as_str().expect("kind") {
            "fast_status" => {
                let blocks = v["blocks"].as_array().expect("blocks");
                let len = |b: &serde_json::Value| b["data"].as_str().expect("data").len() / 2;
                let wanted: Vec<_> = blocks
                    .iter()
                    .map(|b| (b["id"].as_u64().expect("id") as u8, 0, hex(b["data"].as_str().expect("data"))))
                    .collect();
                assert_eq!(fast_reply(&wanted), bytes, "{name}");
                if blocks.iter().all(|b| len(b) == len(&blocks[0])) {
                    let found: Vec<_> = fast_blocks(&bytes, len(&blocks[0]))
                        .map(|b| b.map(|b| (b.id, b.error, b.data.to_vec())).expect("good block"))
                        .collect();
                    assert_eq!(found, wanted, "{name}");
                }
                seen[2] += 1;
            }
            kind => {
                let params = hex(v["params"].as_str().expect("params"));
                let (number, params) = if kind == "instruction" {
                    seen[0] += 1;
                    (v["instruction"].as_u64().expect("number") as u8, params)
                } else {
                    seen[1] += 1;
                    (instruction::STATUS, [&[v["error"].as_u64().expect("error") as u8][..], &params].concat())
                };
                assert_eq!(packet(id, number, &params), bytes, "{name}");
                assert_eq!(parse_all(&bytes), [(id, number, params)], "{name}");
            }
        }
    }
    assert!(seen.iter().all(|n| *n >= 2), "vectors of each kind: {seen:?}");
}

#[test]
fn current_of_minus_one_before_a_velocity_that_starts_with_fd() {
    let data = [0xff, 0xff, 0xfd, 0x00, 0x00, 0x00, 0x10, 0x08, 0x00, 0x00];
    let plain = packet(3, instruction::STATUS, &[&[0][..], &data].concat());
    assert_eq!(plain.len(), 11 + 10 + 1, "one stuffing byte");
    assert_eq!(parse_all(&plain), [(3, instruction::STATUS, [&[0][..], &data].concat())]);

    let fast = fast_reply(&[(3, 0, data.to_vec()), (4, 0x80, data.to_vec())]);
    let mut parser = Parser::new();
    parser.push(&[0xff, 0xff, 0xfd, 0x00, 0x12]);
    parser.push(&fast);
    parser.reset(fast.len());
    parser.push(&[0x00, 0xff]);
    parser.push(&fast);
    let reply = parser.fast_reply(fast.len()).expect("there");
    let blocks: Vec<_> = fast_blocks(reply, 10).map(|b| b.map(|b| (b.id, b.error, b.data))).collect();
    assert_eq!(blocks, [Some((3, 0, &data[..])), Some((4, 0x80, &data[..]))]);
}

#[test]
fn a_packet_that_does_not_fit_is_refused() {
    let mut small = [0; 12];
    assert!(encode(&mut small, 1, instruction::WRITE, &[0; 2]).is_ok());
    let error = encode(&mut small, 1, instruction::WRITE, &[0; 3]).expect_err("one too many").to_string();
    assert!(error.contains("13 bytes") && error.contains("12"), "{error}");
}

#[test]
fn a_length_that_no_answer_can_have_is_not_waited_for() {
    let mut parser = Parser::new();
    parser.reset(20);
    parser.push(&[0xff, 0xff, 0xfd, 0x00, 0x01, 0x50, 0x00]);
    parser.push(&packet(2, instruction::STATUS, &[0]));
    assert_eq!(parser.next_packet().map(|p| p.id), Some(2));
    assert_eq!(parser.rejected(), 1);
}

proptest! {
    #[test]
    fn what_is_written_is_read(
        id in 0u8..=253,
        number in any::<u8>(),
        // Bytes that make stuffing likely.
        params in prop::collection::vec(prop_oneof![4 => Just(0xffu8), 3 => Just(0xfd), 1 => any::<u8>()], 0..120),
    ) {
        let bytes = packet(id, number, &params);
        let holds_header = bytes[7..].windows(4).any(|w| w == HEADER);
        prop_assert!(!holds_header || number == 0xff, "a header inside a packet");
        prop_assert_eq!(parse_all(&bytes), vec![(id, number, params)]);
    }

    #[test]
    fn packets_survive_noise_between_them(
        noise in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..30), 4),
        cut in 1usize..12,
    ) {
        let good: Vec<_> = (0..3u8).map(|i| packet(i, instruction::STATUS, &[0, i, 0xff, 0xff, 0xfd])).collect();
        let truncated = &good[0][..good[0].len() - cut];
        let stream = [&noise[0][..], &good[0], &noise[1], truncated, &good[1], &noise[2], &good[2], &noise[3]].concat();
        let found: Vec<u8> = parse_all(&stream).into_iter().filter(|p| p.1 == instruction::STATUS).map(|p| p.0).collect();
        prop_assert!(found.len() >= 3 && [0, 1, 2].iter().all(|i| found.contains(i)), "{found:?}");
    }

    #[test]
    fn a_damaged_packet_is_not_taken_for_a_good_one(byte in 0usize..18, flip in 1u8..=255) {
        let mut bytes = packet(7, instruction::STATUS, &[0, 1, 2, 3, 4, 5, 6, 7, 8]);
        let place = byte.min(bytes.len() - 1);
        bytes[place] ^= flip;
        prop_assert_eq!(parse_all(&bytes), vec![]);
    }

    #[test]
    fn a_damaged_block_costs_only_itself(block in 0usize..5, byte in 0usize..9, flip in 1u8..=255) {
        let blocks: Vec<_> = (0..5u8).map(|i| (i, 0, vec![i, 0xff, 0xff, 0xfd, 0])).collect();
        let mut bytes = fast_reply(&blocks);
        bytes[8 + 9 * block + byte] ^= flip;
        let found: Vec<_> = fast_blocks(&bytes, 5).map(|b| b.map(|b| b.id)).collect();
        let wanted: Vec<_> = (0..5u8).map(|i| (usize::from(i) != block).then_some(i)).collect();
        prop_assert_eq!(found, wanted);
    }

    #[test]
    fn hostile_bytes_do_no_harm(bytes in prop::collection::vec(prop_oneof![
        3 => Just(0xffu8), 2 => Just(0xfd), 3 => Just(0x00), 2 => Just(0xfe), 1 => Just(0x55), 4 => any::<u8>()
    ], 0..2000), total in 0usize..400, data in 1usize..20) {
        parse_all(&bytes);
        let mut parser = Parser::new();
        let mut rest = &bytes[..];
        while !rest.is_empty() {
            let n = parser.push(rest).max(1);
            rest = &rest[n.min(rest.len())..];
            if let Some(reply) = parser.fast_reply(total) {
                prop_assert!(reply.len() <= total);
                fast_blocks(reply, data).for_each(drop);
            }
            parser.give_up();
        }
    }
}
